from __future__ import annotations

from pathlib import Path

import pytest

from nw_base.files.shipped import available, shipped
from nw_eval.suite import draft_suite, load_suite, tier_problems
from nw_gate.stats.betting import trials_to_certify
from nw_scenes.real import REAL, scan_of
from nw_sim.catalogue import match_scenes, names
from nw_sim.rendering import DRAFTED, PUBLISHED


@pytest.mark.parametrize("path", sorted(shipped("suites").glob("*.yaml")), ids=lambda p: p.stem)
def test_a_shipped_suite_loads_under_its_own_name_and_says_what_it_is_for(path: Path) -> None:
    assert load_suite(path).name == path.stem
    assert path.read_text(encoding="utf-8").startswith("# ")


@pytest.mark.parametrize("path", sorted(shipped("suites").glob("*.yaml")), ids=lambda p: p.stem)
def test_a_shipped_suite_names_scenes_that_exist(path: Path) -> None:
    patterns = load_suite(path).scenes
    fetched = [scan_of(each) for each in patterns if each.startswith(REAL)]  # By their users.
    here = [each for each in patterns if not each.startswith(REAL)]
    scenes = [scene.name for scene in match_scenes(here)] if here else []
    assert set(scenes) <= set(names())
    assert scenes or fetched
    assert tier_problems(draft_suite(path), scenes, ()) == []


def test_the_smoke_suite_is_two_scenes_of_two_trials_with_every_image() -> None:
    smoke = load_suite("smoke")
    assert (len(smoke.scenes), smoke.trials, smoke.record) == (2, 2, "all")
    assert smoke.gate.success_rate is None


def test_the_hurdles_suite_can_pass_its_own_bar() -> None:
    hurdles = load_suite("hurdles")
    assert hurdles.gate.success_rate == 0.75
    scenes = [name for name in names() if name.startswith("hurdles/")]
    assert len(scenes) >= 8
    assert len(scenes) * hurdles.trials > 2 * trials_to_certify(0.75, hurdles.gate.confidence)


def test_suites_that_are_told_the_ground_share_their_trials_and_draw_as_published() -> None:
    assert load_suite("smoke").digest == load_suite("hurdles-state").digest
    for name in available("suites"):
        draws = name in {"hurdles", "gaps", "ramps", "stairs", "all"}
        assert load_suite(name).render == (DRAFTED if draws else PUBLISHED), name


def test_a_suite_and_the_one_for_policies_that_are_told_the_ground_differ_in_pictures() -> None:
    for task in ("hurdles", "gaps", "ramps", "stairs", "all"):
        seen, told = (load_suite(name) for name in (task, f"{task}-state"))
        assert seen.model_copy(update={"render": PUBLISHED}).digest == told.digest


def test_what_is_available_is_listed_by_name(tmp_path: Path) -> None:
    bundle = tmp_path / "policies" / "mine"
    bundle.mkdir(parents=True)
    (bundle / "policy.yaml").write_text("nw-policy: 1\n", encoding="utf-8")
    (tmp_path / "policies" / "empty").mkdir()
    assert available("policies", tmp_path)["mine"] == bundle
    assert "empty" not in available("policies", tmp_path)
    assert {"hurdles", "smoke"} <= set(available("suites", tmp_path))
