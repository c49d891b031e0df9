"""Names in strangers' files stay within their folder."""

import pytest

from nw_base.files.inside import OutsideError, inside, what_is


@pytest.mark.parametrize(
    "name",
    ["", "/etc/passwd", "..", "../x", "a/../../x", "a\\..\\x", "C:x", "C:/x", "a\0b", "a/" * 5000],
)
def test_a_name_that_leads_out_is_refused(tmp_path, name):
    with pytest.raises(OutsideError):
        inside(tmp_path, name)


def test_a_name_below_the_folder_is_resolved(tmp_path):
    assert inside(tmp_path, "a/./b.obj") == tmp_path.resolve() / "a" / "b.obj"


def test_a_link_to_the_outside_is_refused_and_one_within_is_followed(tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "secret").write_text("x")
    (folder / "real").write_text("y")
    (folder / "out").symlink_to(tmp_path / "secret")
    (folder / "in").symlink_to(folder / "real")
    assert inside(folder, "in") == (folder / "real").resolve()
    with pytest.raises(OutsideError, match="a link on its way leads to"):
        inside(folder, "out")


def test_links_in_a_circle_are_refused(tmp_path):
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(OutsideError):
        inside(tmp_path, "a")


def test_what_no_file_system_can_have_is_nothing(tmp_path):
    (tmp_path / "a").symlink_to(tmp_path / "a")
    for name in ("n" * 300, "a", "a\0b", "none"):
        assert what_is(tmp_path / name) == "nothing"
    assert what_is(tmp_path) == "folder"
