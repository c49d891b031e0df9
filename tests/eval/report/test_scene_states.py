"""Lists of tests say what the verdict says: a scene fails only where the run is REGRESSED."""

from dataclasses import replace

import pytest

from nw_eval.reporting.scene_states import scene_states, worst_first
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.baseline.combine import combined, without_baseline
from nw_gate.stats.interval import Interval
from nw_gate.verdict import SceneDrop

BAR = Gate(success_rate=0.75)


def states(verdict):
    return {item.scene: item.state for item in scene_states(verdict)}


def rows_of(make_row, **reached):
    return [make_row(scene, k, to) for scene, each in reached.items() for k, to in enumerate(each)]


def test_a_scene_below_the_bar_fails_where_the_run_is_regressed_and_is_weak_where_it_passes(
    make_row,
):
    bad = rows_of(make_row, good=[4] * 20, bad=[0] * 20)
    regressed = judge(bad, Gate(success_rate=0.9), {"good": 20, "bad": 20})
    assert regressed.verdict == "REGRESSED"
    assert states(regressed) == {"good": "undecided", "bad": "failed"}
    good = {f"s{k}": [4] * 20 for k in range(8)}
    passing = judge(
        rows_of(make_row, **good, bad=[0, 0, 0, 2, 2]), BAR, {**dict.fromkeys(good, 20), "bad": 5}
    )
    assert passing.verdict == "PASS"
    assert states(passing)["bad"] == "weak"
    assert "failed" not in states(passing).values()


def test_a_critical_scene_that_convicts_says_so_and_an_informational_one_never_fails(make_row):
    gate = Gate(success_rate=0.75, tiers={"bad": "critical", "toy": "informational"})
    rows = rows_of(make_row, good=[4] * 20, bad=[0] * 20, toy=[0] * 20)
    verdict = judge(rows, gate, {"good": 20, "bad": 20, "toy": 20})
    assert states(verdict) == {"bad": "failed", "good": "undecided", "toy": "weak"}
    (bad, *_) = scene_states(verdict)
    assert bad.sentence.startswith("critical, and below the bar 0.75 by its upper bound; success 0")
    assert [item.scene for item in worst_first(scene_states(verdict))] == ["bad", "toy", "good"]


def test_holes_are_errors_of_their_scenes_only(make_row):
    rows = rows_of(make_row, good=[4] * 4, torn=[4, None])
    verdict = judge(rows, BAR, {"good": 4, "torn": 4, "gone": 2})
    assert states(verdict) == {"gone": "error", "good": "undecided", "torn": "error"}
    sentences = {item.scene: item.sentence for item in scene_states(verdict)}
    assert sentences["torn"].startswith("1 trial ended in errors; 2 trials missing; success 1.000")
    assert sentences["gone"] == "2 trials missing; no trial has a result"


def test_nothing_of_an_invalid_run_is_judged(make_row):
    verdict = judge(rows_of(make_row, good=[4] * 20, bad=[0] * 20), BAR, {"good": 20, "bad": 20})
    assert set(states(without_baseline(verdict, "the baseline moved")).values()) == {"unjudged"}


def test_a_run_that_is_regressed_by_nothing_of_its_scenes_blames_none(make_row):
    verdict = judge(rows_of(make_row, a=[4] * 20), BAR, {"a": 20})
    assert states(replace(verdict, verdict="REGRESSED")) == {"a": "undecided"}


@pytest.fixture
def against(regressed):
    """A comparison with a baseline that reached everything, two rounds of each scene."""

    def make(word, now, *, named=""):
        drops = tuple(
            SceneDrop(
                scene=scene, tier="supporting", baseline=1.0, candidate=success, trials=2,
                evidence=3.0, named=scene == named,
            )
            for scene, success in now.items()
        )  # fmt: skip
        scored = [success for success in now.values() if success is not None]
        drop = 1.0 - sum(scored) / len(scored)
        return replace(
            regressed, word=word, trials=4, budget=40, mean_regressed=False, baseline=1.0,
            drop=drop, interval=Interval(0.0, 1.0), scenes=drops, reasons=("because",), curve=None,
        )  # fmt: skip

    return make


@pytest.fixture
def results(make_row, against):
    """What becomes of the scenes `good`, at 1, and `bad`, at 0, in two rounds."""

    def make(word, *, named="", gate=None):
        rows = rows_of(make_row, good=[4, 4], bad=[0, 0])
        found = against(word, {"good": 1.0, "bad": 0.0}, named=named)
        planned = {"good": 2, "bad": 2}
        verdict = combined(judge(rows, gate or Gate(), planned, against=found), found)
        assert verdict.verdict == word
        return {item.scene: (item.result, item.sentence) for item in scene_states(verdict)}

    return make


def test_a_scene_that_the_gate_left_undecided_is_skipped_with_its_counts(results):
    assert results("INCONCLUSIVE") == {
        "bad": (
            "skipped",
            "not decided: success 0.000, completed 0 of 2 trials, baseline 1.000; run more trials",
        ),
        "good": (
            "skipped",
            "not decided: success 1.000, completed 2 of 2 trials, baseline 1.000; run more trials",
        ),
    }


@pytest.mark.parametrize("word", ["PASS", "REGRESSED"])
def test_a_scene_without_a_trial_is_skipped_as_not_run(make_row, against, word):
    comparison = against(word, {"bad": 0.0, "unrun": None})
    rows = rows_of(make_row, bad=[0, 0])
    verdict = combined(judge(rows, Gate(), {"bad": 2, "unrun": 0}, against=comparison), comparison)
    (unrun,) = [each for each in scene_states(verdict) if each.scene == "unrun"]
    assert (unrun.result, unrun.sentence) == (
        "skipped",
        "not run: the verdict was decided without it, baseline 1.000",
    )


def test_a_scene_that_fell_fails_unless_the_whole_verdict_is_pass(results):
    for word in ("REGRESSED", "INCONCLUSIVE"):
        found = results(word, named="bad")
        assert [found["good"][0], found["bad"][0]] == ["skipped", "failed"]
        assert found["bad"][1].startswith(
            "regressed from 1.00 to 0.00; success 0.000, completed 0 of 2"
        )
    passed = results("PASS", named="bad")
    assert [passed["good"][0], passed["bad"][0]] == ["passed", "skipped"]
    assert passed["bad"][1].endswith("; the verdict is PASS, and does not rest on this scene alone")


def test_no_scene_passes_with_nothing_reached_where_the_baseline_reached_more(results):
    """With many scenes the mean may pass before a bad one is named."""
    found = results("PASS")
    assert found["good"][0] == "passed"
    assert found["bad"] == (
        "skipped",
        (
            "not decided: success 0.000, completed 0 of 2 trials, baseline 1.000; the verdict is "
            "PASS, and does not rest on this scene alone"
        ),
    )


def test_an_informational_scene_says_so_and_never_passes_or_fails(results):
    gate = Gate(tiers={"good": "informational"})
    for word in ("PASS", "REGRESSED", "INCONCLUSIVE"):
        result, sentence = results(word, gate=gate)["good"]
        assert result == "skipped"
        assert sentence == (
            "informational, not judged; success 1.000, completed 2 of 2 trials, baseline 1.000"
        )
