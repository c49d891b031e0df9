"""After which trial a run against a baseline may end, and which come next, by bar and baseline.

Plans and baselines are real, of a shipped suite; rows say what the candidate scored.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from nw_eval import api
from nw_eval.api.baseline_comparison import BaselineComparison
from nw_eval.engine.how import How
from nw_eval.engine.machine import Interrupts
from nw_eval.engine.provenance import run_info
from nw_gate.absolute import word_of_bar
from nw_gate.baseline.combine import judge_run
from nw_gate.baseline.judge import compare
from nw_gate.results.baseline_file import write_baseline
from nw_gate.results.provenance import StopInfo
from nw_gate.results.run_folder import RunFolder

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from nw_eval.engine.plan import Plan
    from nw_eval.engine.rounds import RunStanding
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row

    Make = Callable[..., Any]

SCENES = (
    "hurdles/one_low_carpet",
    "hurdles/three_low",
    "hurdles/two_foam_office",
    "hurdles/two_logs_park",
)
CELL = ()


def suite_with(gate: str) -> str:
    return (
        "nw-eval: 1\nname: quick\nrobot: go1\npolicy: go1-parkour\ntrials: 4\nseed: 5\n"
        f"scenes: [{', '.join(SCENES)}]\nrecord: none\n"
        f"gate: {{rounds: 15, least_starts: 1, {gate}}}\n"
    )


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A plan without a baseline, and its run.json: what a baseline must hold for."""
    folder = tmp_path_factory.mktemp("plain")
    (folder / "quick.yaml").write_text(suite_with("success_rate: 0.5"))
    plan = api.plan(folder / "quick.yaml", policy="stand", baseline="none")
    return plan, info_of(plan)


def info_of(plan: Plan) -> RunInfo:
    folder = RunFolder(path=Path("run").resolve())
    return run_info(plan, folder, How(), workers=2)


class Course:
    """A comparison of a candidate, and what it scores in each trial of its order."""

    def __init__(self, plan: Plan, drawn_rows: Make, scores: Any) -> None:
        self.plan, self.run = plan, info_of(plan)
        self.rows: list[Row] = drawn_rows(self.run, scores)
        assert plan.against is not None
        self.against = plan.against
        self.gate = plan.suite.gate

    def comparison(self, *, all_rounds: bool = False) -> BaselineComparison:
        how = How(workers=2, cache=False, all_rounds=all_rounds)
        comparison = BaselineComparison(self.plan, self.against, how)
        comparison.begin(SimpleNamespace(info=self.run), Interrupts())
        return comparison

    def by_one(self) -> RunStanding:
        """Return what one worker ends with, that runs what comes next."""
        comparison = self.comparison()
        ended: dict[int, Row] = {}
        while (now := comparison.next(ended)).pending:
            ended[now.pending[0]] = self.rows[now.pending[0]]
        assert set(ended) == {*range(now.first), *now.followed}, "and nothing more"
        return now

    def stopped(self, standing: RunStanding) -> tuple[list[Row], RunInfo]:
        """Return the rows that are judged, and run.json once they have ended."""
        places = [*range(standing.first), *standing.followed]
        rows = [self.rows[place] for place in places]
        if len(places) == len(self.rows):
            return rows, self.run
        count = Counter(row.scene for row in rows)
        stop = StopInfo(first=standing.first, followed=standing.followed, trials=dict(count))
        return rows, self.run.model_copy(update={"stop": stop})


@pytest.fixture
def course(plain, make_baseline, drawn_rows, tmp_path):
    """The comparison of a candidate with a gate, against a baseline of one score in all scenes."""

    @cache
    def planned(gate: str, baseline: float) -> Plan:
        _, info = plain
        saved = make_baseline(info, {(name, CELL): [baseline] * 30 for name in SCENES})
        path = tmp_path / "shipped.parquet"
        path.unlink(missing_ok=True)
        write_baseline(path, saved)
        (tmp_path / "quick.yaml").write_text(suite_with(gate))
        return api.plan(tmp_path / "quick.yaml", policy="stand", baseline=str(path))

    def make(gate: str, scores: Mapping[str, Any], baseline: float = 1.0) -> Course:
        return Course(planned(gate, baseline), drawn_rows, scores)

    return make


PERFECT = dict.fromkeys(SCENES, 1.0)


def all_but(scene: str, scores: Any) -> dict[str, Any]:
    return {**PERFECT, scene: scores}


def first_met(course: Course, count: int) -> str:
    """Return a scene that the first trials of the order meet most often."""
    return Counter(row.scene for row in course.rows[:count]).most_common(1)[0][0]


def bar_alone(course: Course) -> int:
    """Return after how many of the first trials the bar is decided."""
    for count in range(1, len(course.rows) + 1):
        word = word_of_bar(course.rows[:count], course.gate, list(SCENES))
        if word != "INCONCLUSIVE":
            return count
    raise AssertionError("the bar stays open")


def baseline_alone(course: Course) -> int:
    """Return how many trials are judged against the baseline, with all of them known."""
    found = compare(course.rows, course.run, course.against, course.gate)
    assert found.settled
    return found.trials


def test_the_bar_convicts_before_the_baseline_is_decided(course):
    met = course("success_rate: 0.9, max_drop: 0.2", dict.fromkeys(SCENES, 0.5), baseline=0.75)
    now = met.by_one()
    assert (now.first, now.followed) == (bar_alone(met), ())
    rows, run = met.stopped(now)
    verdict = judge_run(rows, run, met.gate, met.against)
    assert verdict.verdict == "REGRESSED"
    assert verdict.against.word == "INCONCLUSIVE"
    assert "the bar is 0.9" in verdict.reasons[0]
    assert now.first < len(met.rows)


def test_the_baseline_convicts_before_the_bar_is_decided(course):
    met = course("success_rate: 0.45, max_drop: 0.2", dict.fromkeys(SCENES, 0.5))
    now = met.by_one()
    assert (now.first, now.followed) == (baseline_alone(met), ())
    assert word_of_bar(met.rows[: now.first], met.gate, SCENES) == "INCONCLUSIVE"
    rows, run = met.stopped(now)
    verdict = judge_run(rows, run, met.gate, met.against)
    assert (verdict.verdict, verdict.against.word) == ("REGRESSED", "REGRESSED")
    assert verdict.against.trials == now.first


@pytest.mark.parametrize(
    ("gate", "is_bar_last"),
    [
        ("success_rate: 0.88, max_drop: 0.35", True),
        ("success_rate: 0.5, max_drop: 0.15", False),
    ],
)
def test_both_must_pass_and_the_later_of_them_ends_it(course, gate, is_bar_last):
    met = course(gate, PERFECT)
    now, bar, baseline = met.by_one(), bar_alone(met), baseline_alone(met)
    assert (bar > baseline) is is_bar_last
    assert (now.first, now.followed) == (max(bar, baseline), ())
    rows, run = met.stopped(now)
    verdict = judge_run(rows, run, met.gate, met.against)
    assert verdict.verdict == "PASS"
    # Each speaks of its own trials: what came after the baseline passed is the bar's alone.
    assert verdict.against.trials == baseline
    assert verdict.n == now.first
    bounds = judge_run(rows[:-1], run, met.gate, met.against)
    assert bounds.verdict == "INFRASTRUCTURE", "one of them is missing"


def test_without_a_bar_the_baseline_alone_ends_it(course):
    met = course("max_drop: 0.3", PERFECT)
    now = met.by_one()
    assert (now.first, now.followed) == (baseline_alone(met), ())


def test_scenes_that_hold_back_a_pass_are_followed_alone_and_the_bar_rests_on_the_others(course):
    gate = "success_rate: 0.05, max_drop: 0.5, tolerate: 0.4"
    one = first_met(course(gate, PERFECT), 10)
    met = course(gate, all_but(one, [0.0, 1.0, 0.0, 0.0, *[1.0] * 60]))
    now = met.by_one()
    assert now.followed
    assert {met.rows[place].scene for place in now.followed} == {one}
    between = [place for place in range(now.first, now.followed[-1]) if place not in now.followed]
    assert between, "trials of other scenes were left out"
    rows, run = met.stopped(now)
    verdict = judge_run(rows, run, met.gate, met.against)
    assert verdict.verdict == "PASS"
    assert verdict.against.trials == len(rows)
    assert (
        verdict.interval
        == judge_run(
            met.rows[: now.first],
            run.model_copy(
                update={
                    "stop": StopInfo(
                        first=now.first,
                        trials=dict(Counter(row.scene for row in met.rows[: now.first])),
                    )
                }
            ),
            met.gate,
            met.against,
        ).interval
    )


def test_the_bar_is_looked_at_on_whole_beginnings_while_a_scene_holds_back_the_baseline(course):
    gate = "success_rate: 0.75, max_drop: 0.35, tolerate: 0.3"
    one = first_met(course(gate, PERFECT), 10)
    met = course(gate, all_but(one, [0.0, 0.0, *[1.0] * 60]))
    now, bar = met.by_one(), bar_alone(met)
    mean = compare(met.rows, met.run, met.against, met.gate)
    assert now.first == bar, "it passes last"
    assert bar > mean.trials - len([place for place in now.followed if place >= bar])
    rows, run = met.stopped(now)
    verdict = judge_run(rows, run, met.gate, met.against)
    assert (verdict.verdict, verdict.against) == ("PASS", verdict.against)
    assert verdict.against.word == "PASS"


@pytest.mark.parametrize("bar", ["success_rate: 0.5, ", "success_rate: 0.9, ", ""])
def test_a_critical_scene_that_is_followed_convicts(course, bar):
    gate = f"{bar}max_drop: 0.35, tolerate: 0.3"
    one = first_met(course(gate, PERFECT), 10)
    met = course(f"{gate}, tiers: {{{one}: critical}}", all_but(one, [0.0, 0.0, *[0.25] * 60]))
    now = met.by_one()
    rows, run = met.stopped(now)
    verdict = judge_run(rows, run, met.gate, met.against)
    assert verdict.verdict == "REGRESSED"
    assert len(rows) < len(met.rows)


def test_what_nothing_decides_runs_to_the_end_of_the_budget(course):
    met = course("success_rate: 0.75, max_drop: 0.1", dict.fromkeys(SCENES, [1.0, 0.5] * 30), 0.75)
    now = met.by_one()
    assert (now.first, now.followed) == (len(met.rows), ())
    rows, run = met.stopped(now)
    assert run.stop is None
    assert judge_run(rows, run, met.gate, met.against).verdict == "INCONCLUSIVE"


def test_a_scene_that_holds_back_a_pass_and_has_no_more_trials_leaves_it_open_and_ends_it(course):
    gate = "max_drop: 0.35, tolerate: 0.3"
    one = first_met(course(gate, PERFECT), 10)
    # Of the trials that are followed one fails now and then: too few to say it fell, or did not.
    met = course(gate, all_but(one, [0.0, 0.0, *[1.0, 1.0, 1.0, 0.0] * 20]))
    now = met.by_one()
    assert met.rows[now.followed[-1]].scene == one
    assert one not in {row.scene for row in met.rows[now.followed[-1] + 1 :]}
    rows, run = met.stopped(now)
    assert len(rows) < len(met.rows), "trials of others would change nothing"
    verdict = judge_run(rows, run, met.gate, met.against)
    assert (verdict.verdict, verdict.exit_code) == ("INCONCLUSIVE", 3)
    assert now.waits_for == (one,)
    place = verdict.reasons.index(
        f"PASS is withheld: the mean passes, but {one} may have regressed"
    )
    assert verdict.reasons[place + 1] == "this run has no trial of it left"
    assert "more --trials" in verdict.reasons[place + 2]


def test_where_all_rounds_are_wanted_every_trial_comes_next(course):
    met = course("max_drop: 0.3", PERFECT)
    comparison = met.comparison(all_rounds=True)
    ended = dict(enumerate(met.rows[:50]))
    assert comparison.next(ended).pending == tuple(range(50, 60))
    assert comparison.next(dict(enumerate(met.rows))).pending == ()


def test_an_informational_scene_that_has_not_ended_is_run_and_holds_no_ruling_back(course):
    gate = f"max_drop: 0.3, tiers: {{{SCENES[0]}: informational}}"
    met = course(gate, all_but(SCENES[0], 0.0))
    now = met.by_one()
    among = [row.scene for row in met.rows[: now.first]]
    assert SCENES[0] in among, "it has its part of the order"
    lacking = {x: row for x, row in enumerate(met.rows[: now.first]) if row.scene != SCENES[0]}
    later = met.comparison().next(lacking)
    assert later.first == now.first
    assert later.pending == tuple(x for x in range(now.first) if x not in lacking)
    rows, run = met.stopped(now)
    verdict = judge_run(rows, run, met.gate, met.against)
    assert (verdict.verdict, verdict.success) == ("PASS", None if not verdict.n else 1.0)


@pytest.mark.parametrize(
    "seed",
    [pytest.param(seed, marks=pytest.mark.nightly if seed > 5 else ()) for seed in range(24)],
)
def test_workers_that_run_ahead_end_with_the_same_trials_and_verdict(course, seed):
    rng = np.random.default_rng(seed)
    bar = ("", "success_rate: 0.5, ", "success_rate: 0.85, ")[seed % 3]
    tiers = ("", f", tiers: {{{SCENES[1]}: critical}}")[seed % 2]
    scores = {
        name: rng.choice([0.0, 0.5, 1.0], size=30, p=[0.5 * fails, 0.5 * fails, 1 - fails]).tolist()
        for name, fails in zip(SCENES, rng.choice([0.0, 0.1, 0.6], size=4), strict=True)
    }
    met = course(f"{bar}max_drop: 0.35, tolerate: 0.3{tiers}", scores)
    alone = met.by_one()
    workers = int(rng.integers(2, 7))
    comparison, going = met.comparison(), list[int]()
    ended = {}
    while True:
        now = comparison.next(ended)
        if not now.pending:
            break
        going += [place for place in now.pending[:workers] if place not in going]
        place = going.pop(int(rng.integers(len(going))))
        ended[place] = met.rows[place]
    assert now == alone
    # Whoever goes on later with what there is, in one look, finds the same.
    assert met.comparison().next(ended) == alone
    rows, run = met.stopped(alone)
    verdict = judge_run(rows, run, met.gate, met.against)
    if run.stop is not None:
        # It may be left open that a scene which holds back a PASS has no more trials.
        is_held = any("PASS is withheld" in text for text in verdict.reasons)
        assert verdict.verdict in ({"INCONCLUSIVE"} if is_held else {"PASS", "REGRESSED"})
        assert judge_run(rows[::-1], run, met.gate, met.against) == verdict
