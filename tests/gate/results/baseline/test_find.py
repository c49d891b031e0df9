from __future__ import annotations

import pytest

from nw_base.errors import IncomparableError, UsageError
from nw_base.files.shipped import shipped as shipped_folder
from nw_gate.results import baseline_file
from nw_gate.results.baseline_file import baseline_files, find_any, find_baseline


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """The project's baselines and the shipped ones, each with one for `hurdles`."""
    mine, shipped = tmp_path / "mine", tmp_path / "shipped"
    monkeypatch.setattr(baseline_file, "shipped", lambda _: shipped)
    for folder, name in ((mine, "best"), (shipped, "go1-parkour")):
        (folder / "hurdles").mkdir(parents=True)
        (folder / "hurdles" / f"{name}.parquet").write_bytes(name.encode())
    return mine, shipped


def test_a_name_is_looked_for_in_the_project_and_then_among_the_shipped_baselines(folders):
    mine, shipped = folders
    for name in ("best", "hurdles/best"):
        assert find_baseline(name, suite="hurdles", root=mine) == mine / "hurdles/best.parquet"
    found = find_baseline("go1-parkour", suite="hurdles", root=mine)
    assert found == shipped / "hurdles/go1-parkour.parquet"


def test_a_path_is_taken_as_it_is(folders, monkeypatch):
    mine, _ = folders
    path = mine / "hurdles/best.parquet"
    assert find_baseline(str(path), suite="other") == path
    monkeypatch.chdir(path.parent)
    assert find_baseline("best.parquet", suite="other").resolve() == path


@pytest.mark.parametrize(
    ("reference", "sentence"),
    [
        (
            "go1-parkuor",
            "suite 'hurdles' has no baseline 'go1-parkuor'; did you mean 'go1-parkour'?",
        ),
        ("./bset.parquet", r"no baseline at bset\.parquet; did you mean 'best'\?"),
        ("a" * 5000, "has no baseline"),
    ],
)
def test_a_baseline_that_is_not_there_is_named_with_the_nearest_that_is(
    folders, reference, sentence
):
    with pytest.raises(UsageError, match=sentence):
        find_baseline(reference, suite="hurdles", root=folders[0])


def test_where_there_is_no_baseline_at_all_the_error_says_how_to_make_one(folders):
    with pytest.raises(UsageError, match="nw-eval baseline save stairs --policy POLICY"):
        find_baseline("best", suite="stairs", root=folders[0])


def test_two_different_baselines_of_one_name_are_an_error_unless_a_path_says_which(folders):
    mine, shipped = folders
    copy = mine / "hurdles/go1-parkour.parquet"
    copy.write_bytes((shipped / "hurdles/go1-parkour.parquet").read_bytes())
    assert find_baseline("go1-parkour", suite="hurdles", root=mine) == copy
    copy.write_bytes(b"another one")
    with pytest.raises(IncomparableError, match=r"are called 'go1-parkour': .* by its path") as two:
        find_baseline("go1-parkour", suite="hurdles", root=mine)
    assert str(copy) in str(two.value)
    assert str(shipped) in str(two.value)
    assert find_baseline(copy, suite="hurdles", root=mine) == copy


def test_all_baselines_are_listed_and_one_that_is_in_both_places_once(folders):
    mine, shipped = folders
    (mine / "hurdles/go1-parkour.parquet").write_bytes(b"go1-parkour")
    (shipped / "gaps").mkdir()
    (shipped / "gaps/go1-parkour.parquet").write_bytes(b"go1-parkour")
    listed = [mine / "hurdles/best.parquet", mine / "hurdles/go1-parkour.parquet"]
    assert baseline_files("hurdles", root=mine) == tuple(listed)
    assert baseline_files(root=mine) == (*listed, shipped / "gaps/go1-parkour.parquet")


def test_a_baseline_is_found_without_its_suite_by_name_suite_and_name_or_path(folders):
    mine, shipped = folders
    best = mine / "hurdles/best.parquet"
    for reference in ("best", "hurdles/best", best):
        assert find_any(reference, root=mine) == best
    with pytest.raises(
        UsageError, match=r"no baseline 'hurdles/bset'; did you mean 'hurdles/best'\?"
    ):
        find_any("hurdles/bset", root=mine)
    (shipped / "gaps").mkdir()
    (shipped / "gaps/best.parquet").write_bytes(b"best")
    with pytest.raises(UsageError, match=r"several suites have .*; name one: gaps/best, hurdles/"):
        find_any("best", root=mine)
    assert find_any("best", suite="gaps", root=mine) == shipped / "gaps/best.parquet"
    with pytest.raises(UsageError, match="suite 'stairs' has no baseline 'best'"):
        find_any("best", suite="stairs", root=mine)


def test_a_checkout_ships_the_baselines_that_it_commits():
    assert shipped_folder("baselines").parts[-2:] == ("reports", "baselines")
    assert shipped_folder("baselines").is_dir()
