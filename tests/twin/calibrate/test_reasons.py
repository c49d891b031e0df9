"""The reason that is named is the one that was there."""

from pathlib import Path

from films import photograph

from nw_twin.calibrate.calibrate import APART, BLURRED, DARK, GROUP, PLAIN, UNFIT, why_not
from nw_twin.calibrate.features import Matches


def matched(names, inliers, few=()):
    """Return what was matched of photographs, some of which have few features."""
    features = {f"{name}.jpg": 20 if name in few else 2000 for name in names}
    count = len(features) * (len(features) - 1) // 2
    return Matches(
        database=Path("db"), pictures=Path(), features=features, inliers=inliers, pairs=count
    )


def test_each_photograph_left_out_has_its_own_reason():
    all_of_them = [
        *(photograph(name) for name in "abc"),
        photograph("shaken", sharpness=10),
        photograph("wall", sharpness=10, contrast=5),
        photograph("night", sharpness=10, contrast=5, brightness=6),
        photograph("garden"),
        photograph("mirror"),
    ]
    inliers = {
        ("a.jpg", "garden.jpg"): 7,
        ("garden.jpg", "mirror.jpg"): 400,  # Neither was placed.
        ("mirror.jpg", "b.jpg"): 90,
    }
    matches = matched([one.name for one in all_of_them], inliers, few=("wall", "night"))
    found = {one.name: one for one in why_not(all_of_them, {"a", "b", "c"}, matches)}
    assert {name: one.reason for name, one in found.items()} == {
        "shaken": BLURRED,
        "wall": PLAIN,
        "night": DARK,
        "garden": APART,
        "mirror": UNFIT,
    }
    assert found["shaken"].detail.startswith("10%")
    assert "20 features" in found["wall"].detail
    assert " 7 " in found["garden"].detail


def test_where_none_was_placed_matches_with_any_count():
    pair = [photograph("a"), photograph("b")]
    matches = matched("ab", {("a.jpg", "b.jpg"): 500})
    assert {one.reason for one in why_not(pair, (), matches)} == {UNFIT}


def test_a_group_apart_is_named_with_what_would_tie_it():
    all_of_them = [photograph(name) for name in "abcdef"]
    matches = matched("abcdef", {("d.jpg", "e.jpg"): 400, ("c.jpg", "d.jpg"): 17})
    found = why_not(all_of_them, {"a", "b", "c"}, matches, [("d", "e")])
    assert [one.reason for one in found] == [GROUP, GROUP, APART]
    assert found[0].detail == found[1].detail
    assert found[0].detail.startswith("a group of 2, at most 17 matches with one of the largest")
    assert "photograph the way between them" in found[0].detail
