"""Trials on a ladder: the plan of all that may be asked for, and the run in which they are.

A run on a ladder asks after each result for the next trial (`nw_gate.limits`). Trials run in the
order that results alone decide, so that the outcome is the same for one worker and for many.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.plural import plural
from nw_eval.api.plans import plan, plan_of
from nw_eval.engine.rounds import RunStanding
from nw_eval.suite.ladders import COMMANDED_DURATION, climbed_episode
from nw_gate.limits.ladder import Ladder, LimitTrial
from nw_gate.results.request import Request

if TYPE_CHECKING:
    from typing import Self

    from nw_eval.engine.how import How
    from nw_eval.engine.listener import Listener
    from nw_eval.engine.machine import Interrupts
    from nw_eval.engine.plan import Plan
    from nw_eval.engine.session import Session
    from nw_eval.suite import Suite
    from nw_gate.limits.path import TrialPath
    from nw_gate.results.baseline import Stratum
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row
    from nw_policies import Bundle
    from nw_sim.ladders import Ladder as SceneLadder

_LONGEST_NAME = 60
"""Characters of a suite's name."""
_DURATION = 12.0
"""Seconds of a trial, as in the shipped suites."""


def rungs_ladder(family: SceneLadder) -> Ladder:
    """Return a ladder of scenes as the statistics know it: a parameter and its values."""
    values = tuple(rung.value for rung in family.rungs)
    return Ladder(name=family.parameter, rungs=values, unit=family.unit)


def folder_names(ladders: Sequence[str]) -> list[str]:
    """Return a folder's name for each ladder, which no other one has."""
    found: list[str] = []
    for name in ladders:
        plain = plain_name(name) or "ladder"
        number = 1
        while (own := plain if number == 1 else f"{plain}-{number}") in found:
            number += 1
        found.append(own)
    return found


def ladder_plan(
    family: SceneLadder, request: Request, most: int, *, contacts: bool = False
) -> Plan:
    """Return the plan of all trials that a search may ask for, each with its place.

    Args:
        family: the ladder.
        request: robot, policy and seed.
        most: trials of a rung, at most.
        contacts: whether a trial goes on when head or trunk touch something.
    """
    from nw_policies import load_bundle

    robot = request.robot
    if robot is None:
        assert request.policy is not None, "a policy is always named"
        robot = load_bundle(request.policy, checkpoint=request.checkpoint).card.robot
    each = _each(family, most)
    suite = _suite(
        family,
        each,
        robot=robot,
        policy=request.policy,
        seed=request.seed,
        episode={
            "duration": COMMANDED_DURATION if family.is_commanded else _DURATION,
            "contact_termination": not contacts,
        },
    )
    changes = {field.name: getattr(request, field.name) for field in fields(request)}
    return _with_all_trials(plan(suite, **{**changes, "suite": None}), each)


def ladder_plan_of_run(
    family: SceneLadder, run: Plan, most: int, *, bundle: Bundle | None = None
) -> Plan:
    """Return such a plan by the rules of a run: its robot, protocol, seed, episode and pictures.

    Args:
        family: the ladder.
        run: the plan of the run.
        most: trials of a rung, at most.
        bundle: a policy in place of the run's.
    """
    from nw_eval.suite import draft_of

    own, each = run.suite, _each(family, most)
    bundle = bundle or run.bundle
    suite = _suite(
        family,
        each,
        robot=own.robot,
        policy=own.policy,
        seed=own.seed,
        protocol=own.protocol,
        episode=climbed_episode(own.episode, is_commanded=family.is_commanded).model_dump(),
        render=own.render.model_dump(),
    )
    request = Request(
        policy=bundle.reference,
        checkpoint=run.request.checkpoint if bundle is run.bundle else None,
        robot=None if run.robot_folder is None else str(run.robot_folder),
        baseline="none",
        record="none",
        time_limit=run.request.time_limit,
        memory_limit=run.request.memory_limit,
        render=run.request.render,
        collision=run.request.collision,
        allow_code=run.request.allow_code,
    )
    return _with_all_trials(plan_of(request, draft_of(suite), bundle=bundle), each)


def _each(family: SceneLadder, most: int) -> int:
    """Return how many trials each rung needs: a search may ask for all of its trials at one."""
    from nw_base.trials import MAX_TRIALS

    return min(most, MAX_TRIALS // len(family.rungs))


def _suite(family: SceneLadder, trials: int, **settings: Any) -> Suite:
    from nw_eval.suite import new_suite
    from nw_eval.suite.model import Source

    settings = {
        "nw-eval": 1,
        "name": f"limits-{plain_name(family.name)}"[:_LONGEST_NAME].rstrip("-."),
        "trials": trials,
        "record": "none",
        "scenes": tuple(dict.fromkeys(rung.scene for rung in family.rungs)),
        **settings,
    }
    if family.rungs[0].perturbation:
        ((axis, _),) = family.rungs[0].perturbation
        settings["perturb"] = {axis: [rung.value for rung in family.rungs]}
    if family.is_commanded:
        # The axis replaces this command in each trial.
        settings["task"] = {"kind": "velocity", "command": {"constant": {}}}
    return new_suite(settings, Source(file=family.name, folder=Path()))


def _with_all_trials(found: Plan, each: int) -> Plan:
    """Return a plan with the trials of all rungs in the order of a policy's draw."""
    from nw_eval.engine.identity import policy_info
    from nw_eval.engine.plan import DrawnOrder
    from nw_eval.suite import expand
    from nw_gate.baseline.match import draw_trials
    from nw_gate.results.provenance import search_key

    key = policy_info(found.bundle).key
    strata = [(scene.name, cell) for scene in found.scenes for cell in found.suite.perturb.cells]
    order = draw_trials(strata, each, each, candidate=key, suite_digest=found.suite.digest)
    return replace(
        found,
        trials=expand(found.suite, found.scenes, order),
        drawn=DrawnOrder(starts=each, candidate=search_key(key)),
    )


def rung_cells(plan: Plan, family: SceneLadder) -> list[Stratum]:
    """Return the scene of each rung, by the name that rows have, and what is changed there."""
    names = {found.reference: found.scene.name for found in plan.found}
    return [(names.get(rung.scene, rung.scene), rung.perturbation) for rung in family.rungs]


class _AtMost:
    """A listener that hears how many trials may run, in place of how many there are to choose from.

    Args:
        told: hears all else.
        most: trials, at most.
    """

    def __init__(self, told: Listener, most: int) -> None:
        self.message, self.scene, self.trial = told.message, told.scene, told.trial
        self._told, self._most = told, most

    def planned(self, *, total: int, finished: int) -> None:
        """Hear how many trials there are, and how many an earlier run has finished."""
        self._told.planned(total=min(total, self._most), finished=finished)


class Climb:
    """A search, as `engine.session` asks it what comes next.

    Args:
        plan: of all trials that may be asked for.
        family: the ladder.
        search: asks for trials.
        how: how they run.
    """

    errors = 0
    """Trials that ended in an error of the machine."""

    def __init__(self, plan: Plan, family: SceneLadder, search: TrialPath, how: How) -> None:
        from nw_eval.engine.machine import worker_count

        self._plan, self._search = plan, search
        self._how = replace(how, listener=_AtMost(how.told, search.most))
        self._workers = worker_count(how.workers, len(plan.trials))
        rungs = {rung: number for number, rung in enumerate(rung_cells(plan, family))}
        self._places = {
            LimitTrial(rungs[trial.scene, trial.perturbation], trial.index): trial.place
            for trial in plan.trials
            if trial.place is not None
        }
        self._known = {place: trial for trial, place in self._places.items()}
        self._rows: dict[int, Row] = {}

    def carry_out(self, out: Path) -> bool:
        """Run what is asked for, from where a run in the folder stopped; whether a signal came."""
        from nw_base.files.inside import what_is
        from nw_eval.engine import session
        from nw_gate.results.provenance import read_run_info

        begun = out if what_is(out / "run.json") == "file" else None
        folder = session.carry_out(
            self._plan, self._how, out=None if begun else out, resume=begun, comparison=self
        )
        return read_run_info(folder.run_json).interrupted

    def beside(self) -> list[tuple[Row, str]]:
        """Return a completed trial at the hardest cleared rung, and a failed one behind it.

        Each has its rung's value, for people. Where there is none at such a rung the nearest one
        stands for it.
        """
        limit = self._search.limit
        found: list[tuple[Row, str]] = []
        for completed, end in zip((True, False), limit.ends, strict=True):
            rows = [
                (abs(trial.rung - end), self._places[trial], trial.rung)
                for trial in self._search.counted
                if self._rows[self._places[trial]].completed is completed
            ]
            if rows:
                _, place, rung = min(rows)
                found.append((self._rows[place], limit.ladder.says(limit.ladder.rungs[rung])))
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        return None

    def begin(self, own: Session, interrupts: Interrupts) -> RunInfo:
        """Return run.json as it is: nothing runs ahead of the search."""
        del interrupts
        return own.info

    def next(self, ended: Mapping[int, Row]) -> RunStanding:
        """Return which trials count so far, and which are needed next."""
        for place in sorted(ended.keys() - self._rows.keys()):
            row = self._rows[place] = ended[place]
            if not self._search.takes(self._known[place]):
                continue
            if row.status == "ok":
                self._search.tell(self._known[place], row.completed)
            else:
                self.errors += 1
        # Others ran ahead for nothing.
        counted = tuple(sorted(self._places[trial] for trial in self._search.counted))
        needed, word = self._search.next, "decided" if self._search.is_decided else "undecided"
        done = RunStanding(
            first=0, followed=counted, says=f"{word} after {plural(len(counted), 'trial')}"
        )
        # Without the trial that is needed no other one counts.
        if needed is None or self._places.get(needed, -1) in {-1, *ended}:
            return done
        ahead = [self._places[trial] for trial in self._search.ahead(self._workers)]
        return replace(done, pending=tuple(place for place in ahead if place not in ended))

    def run_control(self, indexes: Sequence[int]) -> None:
        """Run nothing: a search has no control."""
        raise AssertionError(f"a search asks for no control: {indexes}")

    def end(self, run: RunInfo) -> None:
        """Do nothing: the search knows its limit."""


def title_of(family: SceneLadder) -> str:
    """Return what the rungs of a ladder are; the title of an axis says its parameter already."""
    return family.title if "+" in family.name else f"{family.title}: {family.parameter}"


def plain_name(name: str) -> str:
    """Return a ladder's name as a suite or a folder may be called."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-.")
