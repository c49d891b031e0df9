from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from nw_base.errors import IncomparableError
from nw_eval.reporting.headline import headline
from nw_eval.suite import Gate
from nw_gate.absolute import judge, word_of_bar
from nw_gate.baseline.combine import combined, judge_run
from nw_gate.baseline.judge import compare
from nw_gate.baseline.match import drawn_order
from nw_gate.results.baseline import trajectory
from nw_gate.results.provenance import PolicyInfo, StopInfo, recheck_key

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_gate.results.baseline import BaselineResults
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row
    from nw_gate.verdict import Verdict

    Make = Callable[..., Any]


@pytest.fixture
def against(make_run, make_baseline, make_against):
    run = make_run(["a"], 20, drawn_from=60)
    return compare([], run, make_against(make_baseline(run, {"a": [1.0] * 60})), Gate())


@pytest.mark.parametrize(
    ("bar", "baseline", "word", "exit_code"),
    [
        ("PASS", "PASS", "PASS", 0),
        ("RAN", "PASS", "PASS", 0),
        ("PASS", "REGRESSED", "REGRESSED", 1),
        ("RAN", "REGRESSED", "REGRESSED", 1),
        ("REGRESSED", "PASS", "REGRESSED", 1),
        ("REGRESSED", "INCONCLUSIVE", "REGRESSED", 1),
        ("INCONCLUSIVE", "REGRESSED", "REGRESSED", 1),
        ("PASS", "INCONCLUSIVE", "INCONCLUSIVE", 3),
        ("RAN", "INCONCLUSIVE", "INCONCLUSIVE", 3),
        ("INCONCLUSIVE", "PASS", "INCONCLUSIVE", 3),
        ("INFRASTRUCTURE", "PASS", "INFRASTRUCTURE", 4),
        ("INFRASTRUCTURE", "REGRESSED", "INFRASTRUCTURE", 4),
    ],
)
def test_bar_and_baseline_must_both_pass_and_either_convicts(
    run_scene, against, bar, baseline, word, exit_code
):  # fmt: skip
    verdict = replace(judge(run_scene("a", [4] * 20), Gate(), {"a": 20}), verdict=bar)
    comparison = replace(against, word=baseline, reasons=("of the baseline",))
    both = combined(verdict, comparison)
    assert (both.verdict, both.exit_code, both.against) == (word, exit_code, comparison)
    assert {"of the baseline", *verdict.reasons} == set(both.reasons)


def test_what_decides_speaks_first(run_scene, against):
    verdict = judge(run_scene("a", [4] * 20), Gate(success_rate=0.75), {"a": 20})
    fell = replace(against, word="REGRESSED", reasons=("it fell",))
    assert combined(verdict, fell).reasons[0] == "it fell"
    low = judge(run_scene("a", [0] * 20), Gate(success_rate=0.75), {"a": 20})
    fine = replace(against, word="PASS", reasons=("no worse",))
    assert combined(low, fine).reasons == (*low.reasons, "no worse")


def test_how_many_more_trials_would_decide_is_said_only_where_they_would(run_scene, against):
    still = replace(against, word="INCONCLUSIVE", reasons=("it is open",), more="8 more decide")
    good = judge(run_scene("a", [4] * 20), Gate(success_rate=0.75), {"a": 20})
    assert combined(good, still).reasons == ("it is open", "8 more decide", *good.reasons)
    low = judge(run_scene("a", [0] * 20), Gate(success_rate=0.75), {"a": 20})
    assert combined(low, still).verdict == "REGRESSED"
    assert combined(low, still).reasons == (*low.reasons, "it is open")


def test_the_same_policy_passes_neither_though_nothing_ran_nor_though_the_bar_fails(
    run_scene, against
):
    same = replace(against, basis="same", word="PASS", reasons=("the same policy",))
    nothing = judge([], Gate(success_rate=0.75), {"a": 0})
    assert combined(nothing, same).verdict == "INFRASTRUCTURE"
    low = judge(run_scene("a", [0] * 20), Gate(success_rate=0.75), {"a": 20})
    assert combined(low, same).verdict == "REGRESSED"
    # An error is a hole, whoever the policy is.
    crashed = judge(run_scene("a", [None]), Gate(), {"a": 1})
    assert combined(crashed, same).verdict == "INFRASTRUCTURE"


def of_the_baseline_itself(make_run: Make, *, ran: float, **changes: Any) -> tuple[RunInfo, Gate]:
    """Return the run of a baseline's own policy, of which one start ran again, and its gate."""
    policy = PolicyInfo(name="go1-act-rgb", card_digest="b1" * 32, checkpoint_digest="bb" * 32)
    stop = StopInfo(first=2, trials={"a": 1, "b": 1})
    run = make_run(
        ["a", "b"], 20, drawn_from=60, drawn_for=recheck_key(7), stop=stop, policy=policy, **changes
    )
    return run, Gate(success_rate=ran)


def in_bits(rows: list[Row], baseline: BaselineResults) -> BaselineResults:
    """Return a baseline that has the bits of some rows at their starts."""
    ways = {(row.scene, row.seed_index): trajectory(row) for row in rows}
    starts = tuple(
        replace(start, trajectory=ways.get((start.scene, start.seed_index), start.trajectory))
        for start in baseline.panels[0].starts
    )
    return replace(
        baseline, panels=(replace(baseline.panels[0], starts=starts), *baseline.panels[1:])
    )


@pytest.fixture
def judged_by(make_against):
    """The verdict on rows against a baseline."""

    def judged(baseline: BaselineResults, rows: list[Row], run: RunInfo, gate: Gate) -> Verdict:
        return judge_run(rows, run, gate, make_against(baseline))

    return judged


def test_a_baseline_is_taken_over_where_one_start_of_every_scene_ran_again_and_is_equal(
    make_run, make_baseline, drawn_rows, judged_by
):
    run, gate = of_the_baseline_itself(make_run, ran=0.75)
    rows = drawn_rows(run, {"a": [1.0], "b": [1.0]})
    baseline = in_bits(rows, make_baseline(run, dict.fromkeys("ab", [1.0] * 60)))
    verdict = judged_by(baseline, rows, run, gate)
    assert (verdict.verdict, verdict.n) == ("PASS", 120)
    over = "same policy as baseline shipped: 2 trials re-run and identical"
    whole = f"PASS · {over} · completed 120 of 120 trials in 2 scenes · success 1.000 "
    assert headline(verdict, run).startswith(whole)
    assert verdict.reasons[0] == f"{over}; the other results come from the baseline"
    # A row of the cache has not run, and a scene of which no start ran says nothing.
    cached = [rows[0], replace(rows[1], cached=True)]
    for short in (rows[:1], cached):
        assert judged_by(baseline, short, run, gate).verdict != "PASS"


@pytest.mark.parametrize(
    "change",
    [{"success": 0.5}, {"outcome": "fell"}, {"waypoints_reached": 3}, {"trajectory": "f" * 16}],
)
def test_a_start_that_ran_again_otherwise_than_the_baseline_says_is_invalid_and_named(
    make_run, make_baseline, drawn_rows, judged_by, change
):
    run, gate = of_the_baseline_itself(make_run, ran=0.75)
    rows = drawn_rows(run, {"a": [1.0], "b": [1.0]})
    baseline = in_bits(rows, make_baseline(run, dict.fromkeys("ab", [1.0] * 60)))
    met = rows[1].seed_index
    wrong = tuple(
        replace(start, **change) if (start.scene, start.seed_index) == ("b", met) else start
        for start in baseline.panels[0].starts
    )
    baseline = replace(baseline, panels=(replace(baseline.panels[0], starts=wrong),))
    verdict = judged_by(baseline, rows, run, gate)
    assert (verdict.verdict, verdict.exit_code) == ("INVALID", 5)
    assert verdict.reasons[0].endswith("is not what its own policy does: 1 of 2 trials differ")
    assert verdict.reasons[1].startswith(f"scene b start {met}: ")
    name, value = next(iter(change.items()))
    assert f"the baseline's {value}" in verdict.reasons[1]
    assert {"trajectory": "bits"}.get(name, name) in verdict.reasons[1]
    assert "baseline shipped, but its results differ from the baseline's" in headline(verdict, run)


def test_where_bits_are_others_the_baseline_s_own_policy_is_compared_with_it_like_any_other(
    make_run, make_baseline, drawn_rows, judged_by
):
    run, gate = of_the_baseline_itself(make_run, ran=0.25)
    baseline = make_baseline(run, dict.fromkeys("ab", [1.0] * 50 + [0.5] * 10))
    elsewhere = run.model_copy(update={"engine": {**run.engine, "cpu": "haswell"}})

    def judged(scores: list[float], gate: Gate) -> Verdict:
        stop = StopInfo(first=2 * len(scores), trials=dict.fromkeys("ab", len(scores)))
        here = elsewhere.model_copy(update={"stop": stop})
        rows = drawn_rows(here, dict.fromkeys("ab", scores), first=stop.first)
        return judged_by(baseline, rows, here, gate)

    verdict = judged([1.0] * 17 + [0.5] * 3, gate)
    assert (verdict.verdict, verdict.n) == ("PASS", 40)
    found = verdict.against
    assert found is not None
    assert found.again is not None
    assert (found.is_own, found.basis, found.again.taken_over) == (True, "panel", False)
    assert found.trials % 2 == 0, "whole rounds alone are looked at"
    assert "computes different results (40 trials re-run)" in " ".join(verdict.reasons)
    said = "same policy as baseline shipped, but this machine or version computes different results"
    assert said in headline(verdict, run)
    # What would be REGRESSED says something of the machine, and nothing of the policy.
    low = judged([0.5] * 20, Gate(success_rate=0.1))
    assert (low.verdict, low.exit_code) == ("INVALID", 5)
    assert low.reasons[0].startswith(
        "this machine or version scores 0.417 less than baseline shipped, 0.043 "
    )
    # Within a round the order of scenes is fixed: the first scene alone convicts nothing.
    stop = StopInfo(first=2, trials=dict.fromkeys("ab", 1))
    here = elsewhere.model_copy(update={"stop": stop})
    rows = drawn_rows(here, {"a": [0.0], "b": [1.0]}, first=2)
    early = judged_by(baseline, rows, here, Gate(false_alarm=0.45)).against
    assert early is not None
    assert (early.word, early.mean_regressed) == ("INCONCLUSIVE", False)
    few = judged([1.0] * 2, Gate())
    assert (few.verdict, few.exit_code) == ("INCONCLUSIVE", 3), "nothing passes for want of trials"
    # The bar alone convicts before a whole round has ended: of a policy that the baseline passed.
    assert judged([0.0], Gate(success_rate=0.8, confidence=0.6)).verdict == "INVALID"
    below = judged([0.9] * 20, Gate(success_rate=0.99, max_drop=0.5))
    assert below.verdict == "REGRESSED", "the baseline itself is below that bar"


def test_the_same_bits_with_another_result_are_invalid_on_every_class_of_machine(
    make_run, make_baseline, drawn_rows, judged_by
):
    run, gate = of_the_baseline_itself(make_run, ran=0.01)
    rows = drawn_rows(run, {"a": [0.5], "b": [0.5]})
    forged = in_bits(rows, make_baseline(run, dict.fromkeys("ab", [1.0] * 60)))
    elsewhere = run.model_copy(update={"engine": {**run.engine, "cpu": "haswell"}})
    verdict = judged_by(forged, rows, elsewhere, gate)
    assert verdict.verdict == "INVALID"
    assert "the same actions, other results" in verdict.reasons[0]
    assert verdict.reasons[1].startswith("scene a start ")
    assert "success 0.5, the baseline's 1.0" in verdict.reasons[1]
    # One trial is enough, among others that went other ways.
    other = replace(rows[0], state_digest="ab" * 32)
    assert judged_by(forged, [other, rows[1]], elsewhere, gate).verdict == "INVALID"
    assert judged_by(forged, [other], elsewhere, gate).verdict != "INVALID"


def test_of_another_candidate_a_baseline_that_its_own_policy_contradicted_makes_the_run_invalid(
    make_run, make_baseline, make_against
):
    moved = (
        "the baseline is not what its own policy does: the same actions, other results",
        "scene a",
    )
    there = make_run(["a"], 20, drawn_from=60)
    against = make_against(make_baseline(there, {"a": [1.0] * 60}))
    begun = against.info.model_copy(update={"moved": moved})
    elsewhere = {**there.engine, "cpu": "haswell"}
    run = make_run(
        ["a"], 20, drawn_from=60, engine=elsewhere, baseline=begun, stop=StopInfo(first=0)
    )
    verdict = judge_run([], run, Gate(), against)
    assert (verdict.verdict, verdict.exit_code) == ("INVALID", 5)
    assert verdict.reasons[:-1] == moved
    own = against.results.manifest
    assert f"`nw-eval baseline verify {own.suite}/{own.name} --trials 100%`" in verdict.reasons[-1]
    renew = f"--policy {own.policy.name} --name {own.name} --renew` saves it again"
    assert verdict.reasons[-1].endswith(renew)


def test_a_second_panel_that_is_true_does_not_speak_for_a_first_one_that_is_forged(
    make_run, make_baseline, drawn_rows, judged_by
):
    run, gate = of_the_baseline_itself(make_run, ran=0.9)
    rows = drawn_rows(run, {"a": [0.5], "b": [0.5]})
    true = in_bits(rows, make_baseline(run, dict.fromkeys("ab", [0.5] * 60)))
    forged = make_baseline(run, dict.fromkeys("ab", [1.0] * 60))
    infos = [
        forged.manifest.panels[0].model_copy(update={"machine": {"cpu": cpu}})
        for cpu in ("here", "there")
    ]
    both = replace(
        forged,
        manifest=forged.manifest.model_copy(update={"panels": tuple(infos)}),
        panels=(
            replace(forged.panels[0], machine=infos[0].machine),
            replace(true.panels[0], machine=infos[1].machine),
        ),
    )
    assert judged_by(both, rows, run, gate).verdict not in {"PASS", "RAN"}


def test_the_bar_rests_on_the_first_trials_alone_and_on_none_that_were_followed(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run("ab", 20, drawn_from=60)
    against = make_against(make_baseline(run, dict.fromkeys("ab", [1.0] * 60)))
    gate = Gate(success_rate=0.8)
    places = [place for place, (scene, *_) in enumerate(order_of(run)) if scene == "b"]
    followed = tuple(place for place in places if place >= 12)[:20]
    judged = [*order_of(run)[:12], *(order_of(run)[place] for place in followed)]
    count = Counter(scene for scene, *_ in judged)
    stop = StopInfo(first=12, followed=followed, trials=dict(count))
    run = run.model_copy(update={"stop": stop})
    good, bad = (drawn_rows(run, dict.fromkeys("ab", score)) for score in (1.0, 0.0))

    def verdict_on(first: list[Row], rest: list[Row]) -> Verdict:
        rows = [*first[:12], *(rest[place] for place in followed)]
        return judge_run(rows, run, gate, against)

    planned = Counter(row.scene for row in good[:12])
    passing = judge(good[:12], gate, planned, drawn=good[:12])
    assert passing.verdict == "INCONCLUSIVE"
    for rest in (good, bad):
        verdict = verdict_on(good, rest)
        assert (verdict.interval, verdict.success) == (passing.interval, passing.success)
        # What was followed is counted scene by scene all the same.
        assert sum(item.n for item in verdict.per_scene) == 12 + len(followed)
    low = judge(bad[:12], gate, planned, drawn=bad[:12])
    assert verdict_on(bad, good).interval == low.interval
    assert verdict_on(bad, good).verdict == "REGRESSED"
    # Without a stop all trials bear on it, scene by scene.
    whole = run.model_copy(update={"stop": None})
    assert judge_run(good, whole, gate, against).interval.low > passing.interval.low


def order_of(run: RunInfo) -> list[Any]:
    return drawn_order(run, [(name, ()) for name in run.scenes], run.suite["trials"])


def test_informational_scenes_bear_on_no_bar_of_a_draw(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a", "toy"], 20, drawn_from=60)
    against = make_against(make_baseline(run, {"a": [1.0] * 60, "toy": [1.0] * 60}))
    gate = Gate(success_rate=0.7, tiers={"toy": "informational"})
    count = dict.fromkeys(["a", "toy"], 0)
    for scene, *_ in order_of(run)[:30]:
        count[scene] += 1
    run = run.model_copy(update={"stop": StopInfo(first=30, trials=count)})
    rows = drawn_rows(run, {"a": 1.0, "toy": 0.0}, first=30)
    verdict = judge_run(rows, run, gate, against)
    assert (verdict.success, verdict.n) == (1.0, count["a"])
    alone = [row for row in rows if row.scene == "a"]
    assert verdict.interval == judge(alone, gate, {"a": count["a"]}).interval


@pytest.mark.parametrize("tiers", [{}, {"a": "critical"}, {"b": "informational"}])
@pytest.mark.parametrize("level", [1.0, 0.75, 0.25, 0.0])
def test_the_bar_after_each_trial_is_the_bar_of_the_verdict(make_run, drawn_rows, tiers, level):
    run = make_run("abc", 12, drawn_from=60)
    gate = Gate(success_rate=0.6, tiers=tiers)
    rows = drawn_rows(run, {"a": [0.0, 0.5, 1.0] * 20, "b": level, "c": level})
    words = set[str]()
    for count in (*range(1, 8), *range(8, len(rows) + 1, 4)):
        first = rows[:count]
        planned = Counter(row.scene for row in first)
        verdict = judge(first, gate, planned, drawn=first)
        if verdict.verdict == "INFRASTRUCTURE":
            assert "critical scene a has no result" in " ".join(verdict.reasons)
            continue
        words.add(verdict.verdict)
        assert word_of_bar(first, gate, list(run.scenes)) == verdict.verdict
    assert "INCONCLUSIVE" in words


def test_what_was_found_out_of_a_baseline_on_this_machine_is_of_that_baseline_alone(
    make_run, make_baseline, drawn_rows, make_against, make_control
):
    there = make_run(["a"], 20, drawn_from=60)
    baseline = make_baseline(there, {"a": [1.0] * 60})
    begun = make_against(baseline).info.model_copy(update={"checked": "control"})
    elsewhere = {**there.engine, "cpu": "haswell"}
    run = make_run(["a"], 20, drawn_from=60, engine=elsewhere, baseline=begun)
    rows = drawn_rows(run, {"a": 1.0})
    same_file = make_against(baseline, make_control(run, baseline, {"a": 1.0}))
    found = judge_run(rows, run, Gate(max_drop=0.3), same_file).against
    assert found is not None
    assert (found.basis, found.word) == ("control", "PASS")
    assert found.curve is not None
    assert [points[0].drop for points in found.curve] == [0.0, 0.15, 0.3]
    other = replace(same_file, info=begun.model_copy(update={"sha256": "5b" * 32}))
    with pytest.raises(IncomparableError, match=r"cpu haswell, the baseline's zen 4"):
        judge_run(rows, run, Gate(max_drop=0.3), other)


def test_an_open_run_says_about_how_many_more_trials_would_settle_it(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a", "b"], 4, drawn_from=60)
    against = make_against(make_baseline(run, dict.fromkeys("ab", [1.0] * 55 + [0.5] * 5)))
    verdict = judge_run(drawn_rows(run, dict.fromkeys("ab", 1.0)), run, Gate(), against)
    assert verdict.verdict == "INCONCLUSIVE"
    assert re.fullmatch(
        r"if the candidate is as it looks so far, about \d+ more trials decide with \d+ % "
        r"probability(, \d+ with \d+ %)?; --resume with more --trials runs them",
        verdict.reasons[1],
    )


def test_a_run_whose_control_has_not_started_misses_trials_and_is_not_refused(
    make_run, make_baseline, make_against
):
    there = make_run(["a"], 20, drawn_from=60)
    against = make_against(make_baseline(there, {"a": [1.0] * 60}))
    elsewhere = {**there.engine, "cpu": "haswell"}
    cut = make_run(["a"], 20, drawn_from=60, engine=elsewhere, baseline=against.info)
    verdict = judge_run([], cut, Gate(), against)
    assert (verdict.verdict, verdict.exit_code) == ("INFRASTRUCTURE", 4)
    assert "20 trials missing" in verdict.reasons[0]
