from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from nw_eval.errors import SuiteError, UsageError
from nw_eval.suite import Suite, check_scenes, check_tiers, load_suite, override

if TYPE_CHECKING:
    from pathlib import Path

KNOWN = ("hurdles/one_low", "hurdles/three_low", "stairs/short")


def suite(folder: Path, scenes: str, tiers: str = "{}") -> Suite:
    path = folder / "suite.yaml"
    path.write_text(
        "nw-eval: 1\nname: x\nrobot: go1\npolicy: p\ntrials: 1\nseed: 1\n"
        f"scenes: {scenes}\ngate:\n  tiers: {tiers}\n",
        encoding="utf-8",
    )
    return load_suite(path)


def test_names_and_globs_that_match_are_fine(tmp_path: Path) -> None:
    good = suite(tmp_path, "[hurdles/*, stairs/short]", "{hurdles/*: critical}")
    check_scenes(good, KNOWN)
    check_tiers(good, KNOWN)


def test_patterns_and_tiers_that_match_nothing_are_told_together(tmp_path: Path) -> None:
    wrong = suite(tmp_path, "[hurdles/*, stair/*]", "{hurdles/three_lo: critical}")
    with pytest.raises(SuiteError) as caught:
        check_scenes(wrong, KNOWN)
    first, second = (str(problem).split("suite.yaml:")[1] for problem in caught.value.problems)
    assert first == "7:21: no scene matches 'stair/*'; did you mean 'stairs/short'?"
    assert second.startswith(
        "9:11: gate.tiers: the suite runs no scene 'hurdles/three_lo'; did you"
    )
    assert "'hurdles/three_low'" in second


def test_a_tier_of_a_scene_that_exists_but_is_not_run_is_told(tmp_path: Path) -> None:
    wrong = suite(tmp_path, "[hurdles/*]", "{stairs/short: critical}")
    with pytest.raises(SuiteError, match="runs no scene 'stairs/short'"):
        check_scenes(wrong, KNOWN)


def test_paths_are_left_to_whoever_opens_them(tmp_path: Path) -> None:
    mixed = suite(tmp_path, "[hurdles/*, ./mine, 'neverwhere:/data/x']", "{mine: critical}")
    check_scenes(mixed, KNOWN)
    check_tiers(mixed, [*KNOWN, "mine"])
    with pytest.raises(SuiteError, match="runs no scene 'mine'"):
        check_tiers(mixed, KNOWN)


def test_a_folder_beside_the_suite_is_a_path_by_any_name(tmp_path: Path) -> None:
    (tmp_path / "places" / "yard").mkdir(parents=True)
    check_scenes(suite(tmp_path, "[places/yard, places/*]"), KNOWN)
    with pytest.raises(SuiteError, match="no scene matches 'places/yar'"):
        check_scenes(suite(tmp_path, "[places/yar]"), KNOWN)
    for pattern in ("x" * 1000, "a**b", "[", "a\\0b"):
        with pytest.raises(SuiteError, match="no scene matches"):
            check_scenes(suite(tmp_path, f'["{pattern}"]'), KNOWN)


def test_a_scenes_own_name_wins_over_a_glob(tmp_path: Path) -> None:
    tiers = "{hurdles/*: informational, hurdles/one_low: critical}"
    gate = suite(tmp_path, "[hurdles/*]", tiers).gate
    assert gate.tier("hurdles/one_low") == "critical"
    assert gate.tier("hurdles/three_low") == "informational"
    assert gate.tier("stairs/short") == "supporting"


def test_an_override_keeps_what_it_does_not_name(tmp_path: Path) -> None:
    before = suite(tmp_path, "[hurdles/*]", "{hurdles/*: critical}")
    after = override(before, trials=7)
    assert after.trials == 7
    assert after.gate == before.gate
    assert after.source is before.source
    assert override(before) == before


def test_an_override_that_cannot_be_used_names_the_option(tmp_path: Path) -> None:
    before = suite(tmp_path, "[hurdles/*]")
    with pytest.raises(UsageError, match="--trials 0: input should be greater"):
        override(before, trials=0)
    with pytest.raises(UsageError, match="--record 'fail'"):
        override(before, record="fail")
