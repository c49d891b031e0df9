"""A folder that a user names appears whole, or nothing does."""

import os

import pytest

from nw_base.errors import Problem, SceneError, StoreError, UsageError
from nw_base.files.cache import new_folder


def tree(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def test_what_is_written_appears_at_once_with_the_folders_above_it(tmp_path):
    with new_folder(tmp_path / "a" / "b" / "mine") as staged:
        (staged / "one").write_text("1")
        assert staged.name == "mine"
        assert not (tmp_path / "a" / "b" / "mine").exists()
    assert tree(tmp_path) == ["a", "a/b", "a/b/mine", "a/b/mine/one"]


@pytest.mark.parametrize("error", [UsageError("no"), KeyboardInterrupt(), OSError(28, "full")])
def test_of_a_failure_nothing_is_left_but_what_was_there(tmp_path, error):
    (tmp_path / "a").mkdir()

    def fail():
        with new_folder(tmp_path / "a" / "b" / "c" / "mine") as staged:
            (staged / "one").write_text("1")
            raise error

    with pytest.raises(StoreError if isinstance(error, OSError) else type(error)):
        fail()
    assert tree(tmp_path) == ["a"]


@pytest.mark.parametrize(
    ("out", "words"),
    [
        ("none/..", "there is no .*none; write the path without `..`"),
        ("none/../x", "there is no .*none; write"),
        ("file/x", "file is not a folder"),
        ("file/x/y", "file is not a folder"),
        ("file", "is there already"),
        ("link", "is there already"),
        ("link/x", "link is not a folder"),
        ("n" * 300, "too long"),
        ("n" * 300 + "/x", "too long"),
    ],
)
def test_a_place_where_no_folder_can_be_is_the_users_error(tmp_path, out, words):
    (tmp_path / "file").write_text("here")
    (tmp_path / "link").symlink_to("nowhere")
    with pytest.raises(UsageError, match=words), new_folder(tmp_path / out):
        raise AssertionError(os.fspath(out))
    assert tree(tmp_path) == ["file", "link"]


def test_errors_name_the_folder_that_the_user_knows(tmp_path):
    for called, name in ((None, "mine"), (tmp_path / "theirs", "theirs")):

        def fail(called=called):
            with new_folder(tmp_path / "mine", called=called) as staged:
                problem = Problem(file=f"{staged}/a", line=1, column=2, message=f"see {staged}/b")
                raise SceneError([f"{staged}/c is none", problem], fix=f"remove {staged}/d")

        with pytest.raises(SceneError) as error:
            fail()
        known = tmp_path / name
        assert str(error.value) == (
            f"{known}/c is none\n{known}/a:1:2: see {known}/b; remove {known}/d"
        )
        assert error.value.problems[0].file == f"{known}/a"
