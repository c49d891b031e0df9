from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nw_base.errors import IncomparableError, StoreError
from nw_eval.reporting.tables.scenes import scenes_table
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.baseline.judge import compare
from nw_gate.baseline.match import draw_trials, drawn_order
from nw_gate.results.provenance import PolicyInfo
from nw_gate.results.request import Request
from nw_gate.stats.baseline.trials import CRITICAL_TRIALS

if TYPE_CHECKING:
    from nw_gate.results.provenance import RunInfo


GATE = Gate(max_drop=0.1, scene_drop=0.1, least_starts=1)
WAYS = {"drawn_from": 60}
STRETCH = {"suppress_health_check": [HealthCheck.function_scoped_fixture], "deadline": None}


@pytest.mark.parametrize(("alpha", "trials"), [(1 / 2.48, 10), (1 / 6.3, 20), (0.05, 33)])
@pytest.mark.parametrize("scenes", ["a", "abcd"])
def test_an_unchanged_policy_passes_after_the_trials_that_the_figures_say(
    make_run, make_baseline, drawn_rows, make_against, scenes,
    alpha, trials
):  # fmt: skip
    # E_pass of perfect trials against a perfect baseline: 2.485 after 10, 6.306 after 20, and 20 is
    # reached after 33; no method can do it in fewer than 29, as .9^28 > .05. They are of fresh
    # starts: that the baseline has 60 changes nothing.
    rounds = 40 // len(scenes)
    run = make_run(scenes, rounds, **WAYS)
    against = make_against(make_baseline(run, dict.fromkeys(scenes, [1.0] * 60)))
    rows = drawn_rows(run, dict.fromkeys(scenes, 1.0))
    gate = GATE.model_copy(update={"confidence": 1 - alpha})
    found = compare(rows, run, against, gate, power_forecast=True)
    assert (found.word, found.trials, found.budget, found.starts) == ("PASS", trials, 40, 60)
    assert compare(rows[: trials - 1], run, against, gate).word == "INCONCLUSIVE"
    assert (found.basis, found.claim, found.drop) == ("panel", "fresh", 0.0)
    assert found.interval is not None
    assert found.interval.high < found.max_drop
    sure = f"{100 * (1 - alpha):.4g} % confidence"
    rounded = f"{found.interval.high:.3f}"
    worst = "less than 0.1" if rounded == "0.100" else f"at most {rounded}"
    assert found.reasons[0] == (
        f"{worst} worse than baseline shipped ({sure}, {trials} trials); max_drop is 0.1"
    )
    assert sum(item.trials for item in found.scenes) == trials


@pytest.mark.parametrize(
    ("alpha", "trials"), [(1 / 8.96, 1), (1 / 8.97, 2), (0.01, 2), (1 / 221, 3)]
)
def test_a_policy_that_always_fails_is_convicted_as_soon_as_the_figures_say(
    make_run, make_baseline, drawn_rows, make_against, alpha, trials
):
    # E_regr: (0) 8.9668; (0, 0) 160.93; (0, 0, 0) 4,402.
    run = make_run("abcd", 20, **WAYS)
    against = make_against(make_baseline(run, dict.fromkeys("abcd", [1.0] * 60)))
    gate = GATE.model_copy(update={"false_alarm": alpha})
    found = compare(
        drawn_rows(run, dict.fromkeys("abcd", 0.0)), run, against, gate, power_forecast=True
    )
    assert (found.word, found.trials, found.mean_regressed) == ("REGRESSED", trials, True)
    assert found.interval is not None
    low, high = found.interval
    assert found.tolerate < low < found.drop == 1.0 <= high
    # "At least 0.020 worse" would read as what is tolerated.
    worse = "more than 0.02" if f"{low:.3f}" == "0.020" else f"at least {low:.3f}"
    assert found.reasons[0] == (
        f"mean success is {worse} worse than baseline shipped "
        f"({100 * (1 - alpha):.4g} % confidence, {trials} trial{'s' if trials > 1 else ''}); "
        "tolerate is 0.02"
    )
    assert (high, found.known_high) == (1.0, None), "the end of the range says nothing"


@settings(max_examples=40, **STRETCH)
@given(data=st.data())
def test_neither_the_order_of_rows_nor_what_is_known_beyond_changes_what_is_found(
    make_run, make_baseline, drawn_rows, make_against, data
):
    """The rule of the order: its first trials, and later ones of scenes that are waited for."""
    score = st.sampled_from([0.0, 0.5, 1.0, 1.0, 1.0, None])
    names = ["a", "b", "toy"]
    run = make_run(names, 20, **WAYS)
    baseline = make_baseline(run, {"a": [1.0] * 60, "b": [1.0, 1.0, 0.5] * 20, "toy": [1.0] * 60})
    against = make_against(baseline)
    gate = Gate(
        max_drop=0.3,
        tolerate=0.2,
        scene_drop=0.2,
        tiers={"toy": "informational", "b": data.draw(st.sampled_from(["critical", "supporting"]))},
    )
    visits = st.lists(score, min_size=60, max_size=60)
    rows = drawn_rows(run, {name: data.draw(visits) for name in names})
    count = data.draw(st.integers(0, len(rows)))
    whole = compare(rows[:count], run, against, gate)
    # Trials that have ended beyond the first that has not are looked at only if they are of scenes
    # that are waited for, and come next of those.
    waits = [place for place in range(count, len(rows)) if rows[place].scene != "toy"][:1]
    later = rows[waits[0] + 1 :] if waits else []
    beyond = [row for row in later if data.draw(st.booleans())]
    ahead = data.draw(st.permutations([*rows[:count], *beyond]))
    found = compare(ahead, run, against, gate)
    if whole.settled:
        assert found == whole
    used = sum(item.trials for item in found.scenes)
    assert used >= sum(item.trials for item in whole.scenes)
    if whole.word == "INCONCLUSIVE" and not any("withheld" in text for text in whole.reasons):
        assert found == whole, "the first that has not ended is waited for"
    # What all of the rows show, they show whatever of it is told first.
    every = compare(rows, run, against, gate)
    assert compare(data.draw(st.permutations(rows)), run, against, gate) == every


def often_met(run: RunInfo, trials: int) -> str:
    """Return a scene that the first trials of a run's order meet most often."""
    order = drawn_order(run, [(name, ()) for name in run.scenes], run.suite["trials"])
    return Counter(scene for scene, _, _ in order[:trials]).most_common(1)[0][0]


def test_a_pass_waits_for_a_scene_that_may_have_regressed_and_follows_its_trials_alone(
    make_run, make_baseline, drawn_rows, make_against
):
    names = [f"s{number:02d}" for number in range(12)]
    run = make_run(names, 20, **WAYS)
    against = make_against(make_baseline(run, dict.fromkeys(names, [1.0] * 60)))
    gate = Gate(max_drop=0.2, tolerate=0.15, scene_drop=0.1)
    one = often_met(run, 15)
    rows = drawn_rows(run, {**dict.fromkeys(names, 1.0), one: [0.0, 0.0, *[1.0] * 60]})
    whole = compare(rows, run, against, gate)
    cuts = [compare(rows[:count], run, against, gate) for count in range(len(rows))]
    words = f"PASS is withheld: the mean passes, but {one} may have regressed"
    held = next(count for count, found in enumerate(cuts) if words in found.reasons)
    assert whole.word == "PASS"
    assert held < whole.trials
    # From there on only trials of that scene are judged: others may have ended, and show nothing.
    own = [row for row in rows[held:] if row.scene == one]
    failing = drawn_rows(run, dict.fromkeys(names, 0.0))[held:]
    others = [row for row in failing if row.scene != one]
    assert compare([*rows[:held], *own, *others], run, against, gate) == whole
    assert compare([*rows[:held], *own], run, against, gate) == whole
    assert whole.drop == cuts[held].drop, "the mean rests on the first trials alone"
    for before, after in zip(cuts[held].scenes, whole.scenes, strict=True):
        more = whole.trials - held if before.scene == one else 0
        assert after.trials == before.trials + more
    missing = compare([*rows[:held], *own[1:]], run, against, gate)
    assert missing == cuts[held], "its next trial comes first, whatever is known beyond"


def test_on_fresh_starts_evidence_is_that_of_a_panel_without_end(
    make_run, make_baseline, drawn_rows, make_against
):
    pinned = make_run(["a"], 3)
    against = make_against(make_baseline(pinned, {"a": [1.0] * 60}))
    run = make_run(["a"], 3, panel="fresh", suite={"seed": 77}, baseline=against.info)
    rows = drawn_rows(run, {"a": 0.0})
    assert [row.seed_index for row in rows] == [0, 1, 2]
    for zeros, evidence, word in (
        (1, 3.7900, "INCONCLUSIVE"),
        (2, 20.3905, "REGRESSED"),  # E_regr (0) 8.8871; (0, 0) 221.7623.
    ):
        found = compare(rows[:zeros], run, against, GATE)
        assert (found.word, found.basis, found.claim) == (word, "fresh", "fresh")
        assert found.scenes[0].evidence == pytest.approx(evidence, abs=5e-5)


def test_a_scene_that_regressed_is_named_even_under_pass_and_convicts_if_critical(
    make_run, make_baseline, drawn_rows, make_against
):
    names = [f"s{number:02d}" for number in range(12)]
    run = make_run(names, 20, **WAYS)
    against = make_against(make_baseline(run, dict.fromkeys(names, [1.0] * 60)))
    one = often_met(run, 15)
    rows = drawn_rows(run, {**dict.fromkeys(names, 1.0), one: 0.0})
    gate = Gate(max_drop=0.25, tolerate=0.2, scene_drop=0.1)
    found = compare(rows, run, against, gate)
    fell = [item for item in found.scenes if item.named]
    assert [(item.scene, item.baseline, item.candidate) for item in fell] == [(one, 1.0, 0.0)]
    assert found.word == "PASS"
    assert any(text.startswith(f"scene {one} regressed: 1.00 -> 0.00") for text in found.reasons)
    critical = compare(rows, run, against, gate.model_copy(update={"tiers": {one: "critical"}}))
    assert critical.word == "REGRESSED"
    assert critical.reasons[0].startswith(f"critical scene {one} regressed: 1.00 -> 0.00")
    assert not critical.mean_regressed
    assert critical.reasons[1].startswith("estimated drop from baseline shipped: ")
    assert not any("largest drops" in text for text in critical.reasons)


def test_a_report_bounds_how_often_a_policy_that_is_good_enough_is_regressed(
    make_run, make_baseline, make_against
):
    run = make_run("abcd", 20, **WAYS)
    against = make_against(make_baseline(run, dict.fromkeys("abcd", [1.0] * 60)))
    for changes, bound in (
        ({}, 0.01),
        ({"tiers": {"a": "critical"}}, 0.01 * (1 + 1 / 4)),
        ({"success_rate": 0.5}, 0.05 + 0.01),
        ({"success_rate": 0.5, "tiers": {"[ab]": "critical"}}, 0.1 + 0.01 * (1 + 2 / 4)),
        ({"tiers": {"a": "critical", "b": "informational"}}, 0.01 * (1 + 1 / 3)),
    ):
        found = compare([], run, against, GATE.model_copy(update=changes))
        assert found.false_alarm == pytest.approx(bound)


def test_a_report_has_the_drops_that_each_scene_s_own_trials_leave_possible(
    make_run, make_baseline, drawn_rows, make_against
):
    names = ["fell", "held", "seen"]
    run = make_run(names, 20, **WAYS)
    against = make_against(make_baseline(run, dict.fromkeys(names, [1.0] * 60)))
    rows = drawn_rows(run, {**dict.fromkeys(names, 1.0), "fell": 0.0}, first=24)
    gate = Gate(max_drop=0.7, tolerate=0.6, scene_drop=0.1, tiers={"seen": "informational"})
    assert {item.interval for item in compare(rows, run, against, gate).scenes} == {None}
    found = compare(rows, run, against, gate, power_forecast=True)
    fell, held, seen = sorted(found.scenes, key=lambda item: item.scene)
    assert fell.named
    assert fell.interval.low > found.scene_drop
    assert held.interval.low == 0.0
    assert 0.1 < held.interval.high < 1.0
    assert seen.interval is None
    verdict = replace(judge([], Gate(), {}), against=found)
    page = scenes_table(verdict)
    cells = [dict(zip(page.columns, row, strict=True)) for row in page.rows]
    own = f"{-fell.interval.high:z.2f} to {-fell.interval.low:z.2f}"
    (header,) = [name for name, cell in cells[0].items() if cell == own]
    assert "99 %" in header
    assert "(95 % lower, 99 % upper), not corrected for the number of scenes" in page.note
    assert header not in scenes_table(verdict, brief=True).columns


def test_informational_scenes_are_in_the_order_and_in_the_table_and_in_no_evidence(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a", "toy"], 20, **WAYS)
    against = make_against(make_baseline(run, {"a": [1.0] * 60, "toy": [0.5] * 60}))
    gate = GATE.model_copy(update={"max_drop": 0.2, "tiers": {"toy": "informational"}})
    rows = drawn_rows(run, {"a": 1.0, "toy": 0.0})
    found = compare(rows, run, against, gate)
    assert (found.word, found.baseline, found.drop) == ("PASS", 1.0, 0.0)
    assert found.budget == sum(row.scene == "a" for row in rows)
    toy = found.scenes[1]
    assert (toy.tier, toy.baseline, toy.candidate) == ("informational", 0.5, 0.0)
    assert (toy.evidence, toy.named) == (1.0, False)
    # Those before the trial that settled it are shown; whether they have ended holds nothing back.
    settled = [place for place, row in enumerate(rows) if row.scene == "a"][found.trials - 1]
    assert toy.trials == sum(row.scene == "toy" for row in rows[:settled])
    only = compare([row for row in rows if row.scene == "a"], run, against, gate)
    assert (only.word, only.trials, only.interval) == (found.word, found.trials, found.interval)
    assert (only.scenes[0], only.scenes[1].candidate) == (found.scenes[0], None)
    with pytest.raises(IncomparableError, match="all are informational"):
        compare(rows, run, against, Gate(tiers={"*": "informational"}))


def test_what_is_changed_in_a_scene_makes_strata_of_their_own(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a"], 20, suite={"perturb": {"friction": (0.6, 1.25)}}, **WAYS)
    icy, dry = ("a", (("friction", 0.6),)), ("a", (("friction", 1.25),))
    against = make_against(make_baseline(run, {icy: [0.75] * 60, dry: [1.0] * 60}))
    found = compare(drawn_rows(run, {icy: 0.0, dry: 1.0}), run, against, GATE)
    assert found.word == "REGRESSED"
    assert found.baseline == 0.875
    assert [item.name for item in found.scenes] == ["a friction 0.6", "a friction 1.25"]
    assert found.scenes[0].drop == 0.75
    assert found.scenes[0].evidence > 3
    assert found.scenes[1].evidence <= 1


def test_the_policy_of_the_baseline_passes_without_a_trial(make_run, make_baseline, make_against):
    run = make_run(["a"], 10, policy=PolicyInfo(
        name="renamed", card_digest="b1" * 32, checkpoint_digest="bb" * 32
    ))  # fmt: skip
    # A class of machine that nobody has checked, few starts and a bad baseline: no matter.
    baseline = make_baseline(
        make_run(["a"], 10, engine={**run.engine, "cpu": "other"}), {"a": [0.05] * 5}
    )
    against = make_against(baseline)
    found = compare([], run, against, GATE)
    assert (found.word, found.basis, found.trials, found.drop) == ("PASS", "same", 0, None)
    assert found.reasons == ("same policy as baseline shipped: no trial re-run",)
    assert found.again is not None
    assert not found.again.taken_over, "what no trial has shown is nobody's result"
    other_card = run.model_copy(
        update={"policy": run.policy.model_copy(update={"card_digest": "b2" * 32})}
    )
    with pytest.raises(IncomparableError):
        compare([], other_card, against, GATE)


@pytest.mark.parametrize(
    "policy",
    [
        PolicyInfo(name="object", card_digest="b1" * 32, checkpoint_digest="unnamed"),
        PolicyInfo(
            name="far",
            adapter="remote",
            card_digest="b1" * 32,
            # Of nothing: the server says not which policy it serves.
            checkpoint_digest="e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
        ),
    ],
)
def test_a_policy_that_nobody_can_identify_is_tested_even_against_itself(
    make_run, make_baseline, make_against, policy
):
    run = make_run(["a"], 20, policy=policy, **WAYS)
    baseline = make_baseline(run, {"a": [1.0] * 60})
    named = baseline.manifest.policy.model_copy(
        update={"card_digest": policy.card_digest, "checkpoint_digest": policy.checkpoint_digest}
    )
    baseline = replace(baseline, manifest=baseline.manifest.model_copy(update={"policy": named}))
    assert compare([], run, make_against(baseline), GATE).word == "INCONCLUSIVE"


def test_a_policy_that_failed_by_itself_scores_nothing_wherever_it_got_to(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a"], 20, **WAYS)
    rows = [
        replace(row, outcome="policy_failed", end_reason="action", error_type="policy_error")
        for row in drawn_rows(run, {"a": 0.75})
    ]
    found = compare(rows, run, make_against(make_baseline(run, {"a": [0.75] * 60})), GATE)
    assert (found.word, found.scenes[0].candidate) == ("REGRESSED", 0.0)
    # A baseline that fails so is scored so: who fails alike is no worse.
    baseline = make_baseline(run, {"a": [0.75] * 40 + [1.0] * 20}, outcome="policy_failed")
    assert compare(rows, run, make_against(baseline), GATE).baseline == pytest.approx(1 / 3)


def test_a_trial_that_ended_in_an_error_counts_worst_for_each_side(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a", "b"], 20, **WAYS)
    against = make_against(make_baseline(run, dict.fromkeys("ab", [1.0] * 60)))
    gate = Gate(max_drop=0.3)

    def of(b: list[float | None]) -> Any:
        return compare(drawn_rows(run, {"a": 1.0, "b": b}), run, against, gate, power_forecast=True)

    whole, errored, failed = (of([1.0, 1.0, x, *[1.0] * 60]) for x in (1.0, None, 0.0))
    # For PASS it is a failure, for REGRESSED a success, and no part of what is estimated.
    assert (whole.word, errored.word) == ("PASS", "PASS")
    assert whole.trials < errored.trials == failed.trials
    assert errored.interval.high == failed.interval.high
    assert errored.interval.low < failed.interval.low
    assert (errored.drop, errored.scenes[1].candidate) == (0.0, 1.0)
    assert failed.drop > 0.0
    assert sum(item.trials for item in errored.scenes) == errored.trials - 1
    none = compare(drawn_rows(run, {"a": None, "b": None}), run, against, gate)
    assert (none.word, none.drop, none.trials, none.budget) == ("INCONCLUSIVE", None, 40, 40)
    assert none.reasons == ("no trial has been compared with baseline shipped yet",)


def test_trials_beyond_one_that_has_not_ended_are_not_looked_at(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a", "b"], 20, **WAYS)
    against = make_against(make_baseline(run, dict.fromkeys("ab", [1.0] * 60)))
    rows = drawn_rows(run, {"a": 0.5, "b": 1.0})
    for gap in (0, 1, 3):
        hole = compare([*rows[:gap], *rows[gap + 1 :]], run, against, GATE)
        assert hole == compare(rows[:gap], run, against, GATE)
        assert hole.trials == gap


def test_the_waypoint_from_which_a_scene_that_regressed_parts_is_named(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a", "b"], 20, **WAYS)
    against = make_against(make_baseline(run, dict.fromkeys("ab", [1.0] * 60)))
    found = compare(drawn_rows(run, {"a": 0.5, "b": 1.0}), run, against, GATE)
    fallen, fine = found.scenes
    # Two of four waypoints were always reached, and the third never: they part there.
    assert (fallen.candidate, fallen.waypoint) == (0.5, 3)
    assert (fine.named, fine.waypoint) == (False, None)
    assert found.word == "REGRESSED"
    assert found.reasons[1] == (
        "largest drops, none significant alone: a 1.00 -> 0.50, worse from waypoint 3"
    )


def test_what_is_not_decided_says_what_is_known_of_the_drop(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a"], 20, **WAYS)
    against = make_against(make_baseline(run, {"a": [1.0] * 60}))
    found = compare(
        drawn_rows(run, {"a": [1.0] * 9 + [0.5]}), run, against, GATE, power_forecast=True
    )
    assert found.word == "INCONCLUSIVE"
    assert found.interval is not None
    low, high = found.interval
    assert low < found.tolerate < found.max_drop < high
    assert found.reasons[0] == (
        "the comparison with baseline shipped is undecided: estimated drop 0.050 (10 trials), at "
        f"most {high:.3f} (95 % confidence)"
    )
    assert (round(low, 3), found.known_low) == (0.0, None), (
        "no policy is better than one that never fails"
    )
    assert found.more is not None
    assert found.more.endswith("; --resume with more --trials runs them")
    # Intervals take time: they are for a report.
    fast = compare(drawn_rows(run, {"a": [1.0] * 9 + [0.5]}), run, against, GATE)
    assert (fast.interval, fast.curve) == (None, None)
    assert fast.reasons[0] == "estimated drop from baseline shipped: 0.050 (10 trials)"
    nothing = compare([], run, against, GATE, power_forecast=True)
    assert nothing.reasons == ("no trial has been compared with baseline shipped yet",)


@pytest.fixture
def perfect(make_run, make_baseline, make_against):
    """A run of some scenes with so many rounds, against a baseline that never failed there."""

    def make(names: list[str], rounds: int) -> tuple[RunInfo, Any]:
        run = make_run(names, rounds, **WAYS)
        return run, make_against(make_baseline(run, dict.fromkeys(names, [1.0] * 60)))

    return make


def test_scenes_that_no_trial_has_met_are_told_and_shown_as_such(perfect, drawn_rows):
    names = [f"s{number:02d}" for number in range(30)]
    run, against = perfect(names, 2)
    rows = drawn_rows(run, dict.fromkeys(names, 0.0))
    found = compare(rows, run, against, GATE, power_forecast=True)
    assert (found.word, found.trials) == ("REGRESSED", 2)
    unmet = [item for item in found.scenes if item.candidate is None]
    assert len(unmet) >= 28
    assert {(item.trials, item.drop, item.evidence, item.named) for item in unmet} == {
        (0, None, 1.0, False)
    }
    assert all(item.ends == ([0, 0, 0, 0, 60], [0, 0, 0, 0, 0]) for item in unmet)
    assert found.reasons[1].startswith("largest drops, none significant alone: ")
    assert unmet[0].scene not in " ".join(found.reasons)
    page = scenes_table(replace(judge([], Gate(), {}), against=found))
    lines = [dict(zip(page.columns, row, strict=True)) for row in page.rows]
    (line,) = [line for line in lines if line["scene"] == unmet[0].scene]
    assert (line["trials"], line["success"], line["change"]) == ("0", "none", "")
    assert page.bars[lines.index(line)] is None


def test_no_pass_before_every_critical_scene_has_been_met(perfect, drawn_rows):
    names = [f"s{number:02d}" for number in range(30)]
    run, against = perfect(names, 10)
    rows = drawn_rows(run, dict.fromkeys(names, 1.0))
    free = compare(rows, run, against, GATE)
    assert (free.word, free.trials) == ("PASS", 33)
    unmet = [item.scene for item in free.scenes if item.trials == 0]
    said = f"PASS is for the mean of all scenes: no trial ran in {', '.join(unmet[:3])}"
    assert free.reasons[-1].startswith(said)
    (last,) = [item.scene for item in free.scenes if item.trials == 0][:1]
    gate = GATE.model_copy(update={"tiers": {last: "critical"}})
    held = compare(rows[:33], run, against, gate, power_forecast=True)
    assert held.word == "INCONCLUSIVE"
    assert f"critical scene {last} needs {CRITICAL_TRIALS} trials" in " ".join(held.reasons)
    found = compare(rows, run, against, gate)
    assert (found.word, found.trials) == ("PASS", 33 + CRITICAL_TRIALS)
    assert [item.trials for item in found.scenes if item.scene == last] == [CRITICAL_TRIALS]
    failing = drawn_rows(run, {**dict.fromkeys(names, 1.0), last: 0.0})
    assert compare(failing, run, against, gate).word == "REGRESSED"


def test_a_candidate_that_is_better_so_far_is_said_to_have_risen(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a"], 20, **WAYS)
    against = make_against(make_baseline(run, {"a": [0.5] * 60}))
    found = compare(drawn_rows(run, {"a": [1.0] * 2}), run, against, GATE, power_forecast=True)
    assert found.interval is not None
    low, high = found.interval
    assert found.reasons[0] == (
        "the comparison with baseline shipped is undecided: estimated gain 0.500 (2 trials), a "
        f"drop of at most {high:.3f} (95 % confidence)"
    )
    assert (low, found.known_low) == (-0.5, None)


def test_success_is_what_the_baseline_has_in_the_scenes_that_were_met_less_the_drop(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a", "b"], 5, **WAYS)
    against = make_against(make_baseline(run, {"a": [1.0] * 60, "b": [0.5] * 60}))
    rows = drawn_rows(run, {"a": 0.75, "b": 0.5})
    found = compare(rows, run, against, GATE)
    met = [1.0 if row.scene == "a" else 0.5 for row in rows]
    assert found.trials == len(rows) == 10
    assert found.baseline_met == pytest.approx(sum(met) / 10)
    success = sum(row.success for row in rows) / 10
    assert found.baseline_met - found.drop == pytest.approx(success)
    # From each of these initial states the baseline completed in scene a alone.
    assert found.paired == (0, sum(row.scene == "a" for row in rows), 10)
    none = compare([], run, against, GATE)
    assert (none.paired, none.baseline_met) == (None, None)


def test_a_run_of_some_scenes_is_compared_in_those_and_says_so(
    make_run, make_baseline, drawn_rows, make_against
):
    whole = make_run(["a", "b"], 20, **WAYS)
    against = make_against(make_baseline(whole, {"a": [1.0] * 60, "b": [0.5] * 60}))
    run = make_run(["a"], 20, request=Request(scenes=("a",)), **WAYS)
    found = compare(drawn_rows(run, {"a": 1.0}), run, against, GATE)
    assert (found.baseline, found.left_aside) == (1.0, 1)
    assert found.reasons[-1] == (
        "only a part of the suite was run: 1 scene of the baseline not compared"
    )


def test_rows_of_a_run_without_a_baseline_are_compared_in_an_order_of_their_own(
    make_run, make_baseline, run_rows, make_against
):
    run = make_run(["a", "b", "c"], 15)
    perfect = {name: [1.0] * 15 for name in "abc"}
    against = make_against(make_baseline(run, {name: [1.0] * 45 for name in "abc"}))
    found = compare(run_rows(run, perfect), run, against, GATE)
    assert (found.word, found.claim, found.trials, found.budget) == ("PASS", "fresh", 33, 45)
    # They are taken in the order of a draw, not as they are numbered.
    order = draw_trials(
        [(name, ()) for name in "abc"], 15, 15,
        candidate=run.drawn_by, suite_digest=run.suite_digest,
    )  # fmt: skip
    scene, _, start = order[0]
    failed = {**perfect, scene: [0.0 if index == start else 1.0 for index in range(15)]}
    strict = GATE.model_copy(update={"false_alarm": 1 / 8})
    early = compare(run_rows(run, failed), run, against, strict)
    assert (early.word, early.trials) == ("REGRESSED", 1)
    assert [item.candidate for item in early.scenes if item.scene == scene] == [0.0]


def test_no_claim_about_fresh_starts_takes_a_small_baseline_for_all_there_is(
    make_run, make_baseline, drawn_rows, make_against
):
    # Six starts, all met. Of these six the drop could be .1 only if all but none of the rest
    # failed: one failure makes that "impossible" of the panel. Of fresh starts it says little.
    run = make_run("ab", 6, drawn_from=6)
    against = make_against(make_baseline(run, dict.fromkeys("ab", [1.0] * 6)))
    rows = drawn_rows(run, {"a": [0.0, *[1.0] * 5], "b": 1.0})
    found = compare(rows, run, against, GATE)
    assert found.claim == "fresh"
    assert (found.word, [item.named for item in found.scenes]) == ("INCONCLUSIVE", [False, False])
    assert found.scenes[0].evidence < 4.0
    known = compare(rows, run, against, GATE.model_copy(update={"claim": "panel"}))
    assert (known.claim, known.scenes[0].named) == ("panel", True)


def test_a_claim_about_the_panel_alone_is_a_suite_s_choice_takes_fewer_trials_and_is_said(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run("ab", 20, drawn_from=20)
    against = make_against(make_baseline(run, dict.fromkeys("ab", [1.0] * 20)))
    rows = drawn_rows(run, dict.fromkeys("ab", 1.0))
    panel = GATE.model_copy(update={"claim": "panel"})
    fresh, known = (compare(rows, run, against, gate) for gate in (GATE, panel))
    assert (fresh.claim, known.claim) == ("fresh", "panel")
    assert (fresh.word, known.word) == ("PASS", "PASS")
    assert known.trials < fresh.trials == 33
    limit = (
        "gate.claim is panel: this applies to the baseline's 20 initial states in each scene, not "
        "to new ones"
    )
    assert limit in known.reasons
    assert not any("gate.claim" in text for text in fresh.reasons)
    # Whoever did not meet starts that were drawn from all of the panel cannot claim it.
    for other in (
        make_run("ab", 15),
        make_run("ab", 20, panel="fresh", suite={"seed": 77}, baseline=against.info),
        make_run("ab", 15, drawn_from=15),
    ):
        compare([], other, against, GATE)
        with pytest.raises(IncomparableError, match=r"gate\.claim is panel.*write `claim: fresh`"):
            compare([], other, against, panel)


def test_a_baseline_needs_as_many_starts_as_rounds_and_says_how_many_to_save(
    make_run, make_baseline, make_against
):
    drawn = make_run(["a"], 20, drawn_from=20)
    few = make_against(make_baseline(drawn, {"a": [1.0] * 10}))
    with pytest.raises(
        IncomparableError, match="has 10 initial states in each scene; the run needs 20"
    ) as caught:
        compare([], drawn, few, GATE)
    assert caught.value.exit_code == 5
    command = "nw-eval baseline save hurdles --policy go1-act-rgb --trials 20"
    assert command in str(caught.value)
    enough = make_against(make_baseline(drawn, {"a": [1.0] * 20}))
    # The rule of three starts for each round is gone, for fresh starts too.
    for run in (drawn, make_run(["a"], 20), make_run(["a"], 20, panel="fresh", suite={"seed": 1})):
        assert compare([], run, enough, GATE).claim == "fresh"


def test_a_baseline_that_nobody_can_fall_short_of_is_refused(make_run, make_baseline, make_against):
    run = make_run(["a"], 20, **WAYS)
    against = make_against(make_baseline(run, {"a": [0.1] * 60}))
    with pytest.raises(IncomparableError, match=r"mean success is 0.100: no policy can be worse"):
        compare([], run, against, GATE)


def test_a_run_that_an_older_nw_eval_drew_round_by_round_is_refused(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a"], 20, **WAYS)
    against = make_against(make_baseline(run, {"a": [1.0] * 60}))
    rows = drawn_rows(run, {"a": 1.0})
    old = run.model_copy(update={"run": 1})
    with pytest.raises(
        IncomparableError, match=r"drawn round by round by an older nw-eval.*; run it again"
    ) as caught:
        compare(rows, old, against, GATE)
    assert caught.value.exit_code == 5
    # One that met the first starts of its scenes has them all, in whatever order.
    first = make_run(["a"], 20).model_copy(update={"run": 1})
    assert compare(drawn_rows(first, {"a": 1.0}), first, against, GATE).trials == 20


def test_on_another_class_of_machine_the_baseline_must_have_been_checked(
    make_run, make_baseline, drawn_rows, make_against
):
    here = make_run(["a"], 40, **WAYS)
    against = make_against(make_baseline(here, {"a": [1.0] * 60}))
    elsewhere = {**here.engine, "cpu": "haswell"}
    run = make_run(["a"], 40, engine=elsewhere, baseline=against.info, **WAYS)
    rows = drawn_rows(run, {"a": 1.0})
    with pytest.raises(IncomparableError, match=r"haswell, the baseline's zen 4.*runs some first"):
        compare(rows, run, against, GATE)

    def checked(what: str, by: str = against.info.sha256) -> RunInfo:
        info = against.info.model_copy(update={"checked": what, "sha256": by})
        return run.model_copy(update={"baseline": info})

    alike = compare(rows, checked("bits"), against, GATE)
    assert (alike.basis, alike.word) == ("panel", "PASS")
    assert alike == compare(rows, here, against, GATE)
    # What was found out is of that file alone; and "scores in line" convinces nobody any more.
    for other in (checked("bits", by="5b" * 32), checked("scores")):
        with pytest.raises(IncomparableError, match=r"cpu haswell, the baseline's zen 4"):
            compare(rows, other, against, GATE)


def test_rows_that_are_not_of_the_run_are_refused(
    make_run, make_baseline, drawn_rows, make_against
):
    run = make_run(["a"], 20, **WAYS)
    against = make_against(make_baseline(run, {"a": [1.0] * 60}))
    rows = drawn_rows(run, {"a": 1.0}, first=3)
    with pytest.raises(StoreError, match="appears twice"):
        compare([*rows, rows[1]], run, against, GATE)
    with pytest.raises(StoreError, match="its checkpoint is 77777777, not cccccccc"):
        compare([replace(rows[0], checkpoint_digest="77" * 32)], run, against, GATE)
    with pytest.raises(StoreError, match="it is the baseline's"):
        compare([replace(rows[0], arm="baseline")], run, against, GATE)
    with pytest.raises(StoreError, match="the run has no b"):
        compare([replace(rows[0], scene="b")], run, against, GATE)


def test_a_claim_about_new_starts_needs_a_sample_of_them_and_says_which_command_saves_it(
    make_run, make_baseline, make_against
):
    drawn = make_run(["a"], 20, drawn_from=20)
    few = make_against(make_baseline(drawn, {"a": [1.0] * 20}))
    with pytest.raises(IncomparableError) as caught:
        compare([], drawn, few, Gate())
    assert "has 20 initial states in each scene; a claim about new initial states needs 30" in str(
        caught.value
    )
    assert "nw-eval baseline save hurdles --policy go1-act-rgb --trials 30" in str(caught.value)
    enough = make_run(["a"], 20, drawn_from=30)
    known = make_against(make_baseline(enough, {"a": [1.0] * 30}))
    assert compare([], enough, known, Gate()).claim == "fresh"
    # Of the panel alone it says what it says.
    alone = Gate(claim="panel")
    assert compare([], drawn, few, alone).claim == "panel"
