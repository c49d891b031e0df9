from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from nw_base.errors import UsageError
from nw_eval.suite import Suite, draft_suite, load_suite, override, tier_problems
from nw_gate.results.request import Request

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

KNOWN = ("hurdles/one_low", "hurdles/three_low", "stairs/short")


def write(folder: Path, scenes: str, tiers: str = "{}") -> Path:
    path = folder / "suite.yaml"
    path.write_text(
        "nw-eval: 1\nname: x\nrobot: go1\npolicy: p\ntrials: 1\nseed: 1\n"
        f"scenes: {scenes}\ngate:\n  tiers: {tiers}\n",
        encoding="utf-8",
    )
    return path


def suite(folder: Path, scenes: str, tiers: str = "{}") -> Suite:
    return load_suite(write(folder, scenes, tiers))


def told(folder: Path, tiers: str, failed: Sequence[str] = ()) -> list[str]:
    """Problems of tiers among the known scenes, without the file."""
    draft = draft_suite(write(folder, "[hurdles/*]", tiers))
    found = tier_problems(draft, KNOWN, failed)
    return [str(problem).split("suite.yaml:")[1] for problem in found]


def test_tiers_that_match_are_fine(tmp_path: Path) -> None:
    assert told(tmp_path, "{hurdles/*: critical, stairs/short: informational}") == []


def test_every_tier_that_matches_nothing_is_told_with_its_place(tmp_path: Path) -> None:
    first, second = told(tmp_path, "{hurdles/three_lo: critical, stair/*: critical}")
    assert first.startswith("9:11: gate.tiers: the suite runs no scene 'hurdles/three_lo'; did you")
    assert "'hurdles/three_low'" in first
    assert second.startswith("9:39: gate.tiers: the suite runs no scene 'stair/*'; did you mean")


def test_a_glob_behind_one_that_covers_its_scenes_is_told_for_it_decides_nothing(
    tmp_path: Path,
) -> None:
    (only,) = told(tmp_path, "{hurdles/*: supporting, hurdles/three*: critical}")
    assert only.startswith("9:34: gate.tiers: 'hurdles/three*' decides for no scene: 'hurdles/*'")
    assert told(tmp_path, "{hurdles/three*: critical, hurdles/*: supporting}") == []
    assert told(tmp_path, "{hurdles/*: supporting, hurdles/three_low: critical}") == []


@pytest.mark.parametrize(
    "failed", ["./mine", "/far/mine", "places/mine", "neverwhere:/data/mine", "triangles:mine"]
)
def test_a_tier_of_a_scene_that_cannot_be_opened_echoes_no_fault(
    tmp_path: Path, failed: str
) -> None:
    assert told(tmp_path, "{mine: critical}", [failed]) == []
    assert len(told(tmp_path, "{mine: critical, yours: critical}", [failed])) == 1
    assert len(told(tmp_path, "{mine: critical}")) == 1


def test_the_entries_of_a_faulty_suite_can_still_be_looked_for(tmp_path: Path) -> None:
    path = write(tmp_path, "[hurdles/*, 3, '', hurdles/*, stairs/short]", "{a: critical}")
    draft = draft_suite(path)
    assert draft.suite is None
    assert draft.scenes == {0: "hurdles/*", 4: "stairs/short"}
    assert draft.tiers == ("a",)
    assert (draft.text("policy"), draft.text("trials"), draft.text("nothing")) == ("p", None, None)
    for scenes in ("3", "{a: b}", "null", "[[a]]"):
        assert draft_suite(write(tmp_path, scenes, "[1]")).scenes == {}
        assert draft_suite(write(tmp_path, scenes, "[1]")).tiers == ()


def test_a_scenes_own_name_wins_over_a_glob(tmp_path: Path) -> None:
    tiers = "{hurdles/*: informational, hurdles/one_low: critical}"
    gate = suite(tmp_path, "[hurdles/*]", tiers).gate
    assert gate.tier("hurdles/one_low") == "critical"
    assert gate.tier("hurdles/three_low") == "informational"
    assert gate.tier("stairs/short") == "supporting"


def test_an_override_keeps_what_it_does_not_name(tmp_path: Path) -> None:
    before = suite(tmp_path, "[hurdles/*]", "{hurdles/*: critical}")
    after = override(before, Request(trials=7))
    assert after.trials == 7
    assert after.gate == before.gate
    assert after.source is before.source
    assert override(before, Request()) == before


def test_an_override_that_cannot_be_used_names_the_option(tmp_path: Path) -> None:
    before = suite(tmp_path, "[hurdles/*]")
    with pytest.raises(UsageError, match="--trials 0: must be at least 1"):
        override(before, Request(trials=0))
    with pytest.raises(UsageError, match="--seed -1: must be at least 0"):
        override(before, Request(seed=-1))
    with pytest.raises(UsageError, match="--record 'fail'"):
        override(before, Request(record="fail"))
