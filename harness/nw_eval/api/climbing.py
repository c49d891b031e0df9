"""How far a policy can go: on each ladder the hardest rung that it still completes, with bounds.

A ladder is a row of scenes from easy to hard, or one scene under ever more of a perturbation. The
search in `nw_gate.limits` says after each result which trial is needed next. Trials run in the
order that results alone decide, so that a limit is the same for one worker and for many.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.errors import NwEvalError, UsageError
from nw_base.files.cache import atomic_path
from nw_base.plural import plural
from nw_eval.api.paths import as_path
from nw_eval.api.plans import plan
from nw_eval.api.sweeping import result_folder
from nw_eval.engine.how import How
from nw_eval.engine.rounds import RunStanding
from nw_eval.reporting.html.limits import LadderLimit, RungFilm, film_bytes, write_limits
from nw_gate.limits.find import LimitSearch
from nw_gate.limits.ladder import Ladder, LimitTrial
from nw_gate.results.request import Request

if TYPE_CHECKING:
    from os import PathLike
    from typing import Self

    from nw_eval.engine.machine import Interrupts
    from nw_eval.engine.plan import Plan
    from nw_eval.engine.session import Session
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row
    from nw_sim.ladders import Ladder as SceneLadder

MOST = 120
"""Trials of a ladder, at most: three measured ladders took 20 to 45."""
_LONGEST_NAME = 60
"""Characters of a suite's name."""
_DURATION = 12.0
"""Seconds of a trial, as in the shipped suites."""
_FILMS_SECONDS = 240.0
"""Wall time of all films of a page, at most; those of a ladder take about three seconds."""


@dataclass(frozen=True, kw_only=True)
class FoundLimits:
    """The limits of one policy or of two, ladder by ladder."""

    out: Path
    """The folder of `limits.json`, `limits.md`, `limits.html`, and of the runs."""
    limits: tuple[LadderLimit, ...]
    interrupted: bool
    """Whether trials are missing, since somebody stopped it."""


def limits(
    ladders: Sequence[str] = (),
    *,
    policy: str,
    baseline: str | None = None,
    robot: str | None = None,
    checkpoint: str | PathLike[str] | None = None,
    share: float = 0.5,
    confidence: float = 0.95,
    width: int = 2,
    trials: int = MOST,
    seed: int = 1,
    out: str | PathLike[str] | None = None,
    allow_code: bool = False,
    contacts: bool = False,
    films: bool = True,
    **how: Any,
) -> FoundLimits:
    """Find the hardest rung of each ladder that a policy still completes, with bounds.

    Both bounds hold whenever the search ends. A rung counts as cleared if the policy completes at
    least `share` of its trials there.

    Args:
        ladders: names or globs of ladders, such as `hurdles/bar` or `hurdles/three_low+payload`, or
            folders with a ladder.yaml (default: all built-in ladders of scenes).
        policy: a shipped policy's name, a policy folder, a card, or hub:org/name[@revision].
        baseline: another policy, which meets the same trials and stands beside it.
        robot: a robot's name, its folder, hub:org/name[@revision] or menagerie:NAME (default: the
            card's).
        checkpoint: use these weights instead of the card's.
        share: share of trials, between 0 and 1, that a cleared rung has at least.
        confidence: of each bound.
        width: rungs that the bounds may be apart where a search ends.
        trials: trials of a ladder, at most.
        seed: of the initial states.
        out: a new or empty folder (default: `reports/limits-<number>`).
        allow_code: allow Python code of the policy's card (confined).
        contacts: let a trial continue when head or trunk touch something, which ends it otherwise.
            Policies without cameras often find obstacles by touching them.
        films: show a trial on either side of each limit on the page; this takes some seconds for
            each ladder, after all limits are found.
        how: fields of `How` by name: workers, cache, listener, labels.

    Raises:
        UsageError: there is no such ladder, or an option cannot be used; nothing was run.
        SceneError, PolicyError, PrerequisiteError: nothing was run.
        StoreError: results cannot be written.
    """
    from nw_sim.rollout.confined.start import prepare

    means = How.of(how, "workers", "cache", "listener", "labels")
    if seed < 0:
        raise UsageError(f"--seed {seed} is below 0", fix="give 0 or more")
    families = _families(ladders)
    for family in families:  # What cannot be used is said before anything runs.
        _search(family, share, confidence, width, trials)
    if not allow_code:
        prepare()
    path = None if checkpoint is None else as_path(checkpoint)
    request = Request(
        policy=policy,
        robot=robot,
        checkpoint=path,
        baseline="none",
        record="none",
        allow_code=allow_code,
        seed=seed,
    )
    rivals = [request]
    if baseline is not None:
        rivals.append(replace(request, policy=baseline, checkpoint=None))
    plans = [
        (family, [_planned(family, each, trials, contacts=contacts) for each in rivals])
        for family in families
    ]
    labels = _labels(plans[0][1])
    folder = result_folder(as_path(out), "limits")
    names = _folder_names([family.name for family in families])
    found: list[LadderLimit] = []
    results: list[_Climb] = []
    whole = FoundLimits(out=folder, limits=(), interrupted=False)
    climbs = [
        (family, label, planned, folder / name / f"{number}")
        for (family, both), name in zip(plans, names, strict=True)
        for number, (label, planned) in enumerate(zip(labels, both, strict=True), 1)
    ]
    for family, label, planned, run in climbs:
        search = _search(family, share, confidence, width, trials)
        climb = _Climb(planned, family, search, means)
        interrupted = climb.carry_out(means, run)
        results.append(climb)
        found.append(
            LadderLimit(
                policy=label,
                ladder=family.name,
                title=_title(family),
                limit=search.limit,
                run=run,
                errors=climb.errors,
            )
        )
        # Written after each: what ends a later search costs no earlier one.
        whole = FoundLimits(out=folder, limits=tuple(found), interrupted=interrupted)
        _write_json(whole, folder / "limits.json")
        write_limits(whole.limits, folder)
        if interrupted:
            return whole
    if films:
        shown, remarks = _filmed(whole.limits, results, cache=means.cache)
        whole = replace(whole, limits=shown)
        write_limits(shown, folder, remarks)
    return whole


def _filmed(
    limits: Sequence[LadderLimit], climbs: Sequence[_Climb], *, cache: bool
) -> tuple[tuple[LadderLimit, ...], tuple[str, ...]]:
    """Return limits with films of the trials beside them, and sentences on what is not shown."""
    from nw_eval.api.evidence import KeptEvidence
    from nw_eval.api.evidence_drawn import film_of, films_of
    from nw_gate.results.evidence_check import present_logs
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import RunFolder

    end, found = monotonic() + _FILMS_SECONDS, list[LadderLimit]()
    missing: dict[str, str] = {}
    for each, climb in zip(limits, climbs, strict=True):
        shown = climb.beside()
        folder = RunFolder(path=each.run)
        try:
            logs = present_logs(folder, [row for row, _ in shown])
            known = [(row, value) for row, value in shown if row.trial_id in logs]
            drawn = films_of(
                [(logs[row.trial_id], row.scene) for row, _ in known],
                each.run,
                kept=KeptEvidence.of_run(read_run_info(folder.run_json)) if cache else None,
                most_bytes=film_bytes(len(limits)),
                seconds=end - monotonic(),
            )
        except (NwEvalError, OSError) as error:
            missing[each.ladder] = clean(str(error), at_most=200)
            found.append(each)
            continue
        films = [
            RungFilm(says=f"{value}: {row.outcome}", film=film_of(clip), seconds=clip.seconds)
            for (row, value), clip in zip(known, drawn, strict=True)
            if clip is not None
        ]
        if len(films) < len(shown):
            missing[each.ladder] = "a trial could not be drawn"
        found.append(replace(each, films=tuple(films)))
    remarks = [f"Films of {ladder} are missing: {why}." for ladder, why in missing.items()]
    return tuple(found), tuple(remarks)


def _labels(plans: Sequence[Plan]) -> list[str]:
    """Return what each policy is called: its folder, with a digest where that is not enough.

    Raises:
        UsageError: the baseline is the policy itself.
    """
    from nw_eval.engine.identity import policy_info

    infos = [policy_info(each.bundle) for each in plans]
    names = [info.folder_name for info in infos]
    if len({info.key for info in infos}) < len(infos):
        raise UsageError(
            f"--baseline {names[-1]} is the policy itself",
            fix="name another policy, or leave it out",
        )
    if len(set(names)) == len(names):
        return names
    return [f"{info.folder_name} ({info.short_digest})" for info in infos]


def _folder_names(ladders: Sequence[str]) -> list[str]:
    """Return a folder's name for each ladder, which no other one has."""
    found: list[str] = []
    for name in ladders:
        plain = _plain(name) or "ladder"
        number = 1
        while (own := plain if number == 1 else f"{plain}-{number}") in found:
            number += 1
        found.append(own)
    return found


def _families(names: Sequence[str]) -> list[SceneLadder]:
    """Return the ladders that are meant; the built-in ones where none is named.

    Raises:
        UsageError: a name or glob means one of commands.
        SceneError: there is no such ladder, or a folder's cannot be read.
    """
    from fnmatch import fnmatchcase

    from nw_sim.ladders import ladder_named, ladders

    known = ladders()
    found: list[SceneLadder] = []
    for name in names:
        matching = [each for each in known if fnmatchcase(each.name, name)]
        # A glob means what can be climbed of what it matches.
        climbable = [each for each in matching if not each.rungs[0].command]
        found += climbable or matching or [ladder_named(name)]
    if not names:
        found = [each for each in known if "+" not in each.name]
    for each in found:
        if each.rungs[0].command:
            raise UsageError(
                f"the rungs of {each.name} are commands; limits climbs scenes and perturbations",
                fix="leave it out; a suite with the task `velocity` evaluates commands",
            )
    return list({each.name: each for each in found}.values())


def _search(
    family: SceneLadder, share: float, confidence: float, width: int, most: int
) -> LimitSearch:
    values = tuple(rung.value for rung in family.rungs)
    ladder = Ladder(name=family.parameter, rungs=values, unit=family.unit)
    return LimitSearch(ladder, share=share, confidence=confidence, width=width, most=most)


def _planned(family: SceneLadder, request: Request, most: int, *, contacts: bool) -> Plan:
    """Return the plan of all trials that a search may ask for, each with its place."""
    from nw_base.trials import MAX_TRIALS
    from nw_eval.engine.identity import policy_info
    from nw_eval.engine.plan import DrawnOrder
    from nw_eval.suite import expand, new_suite
    from nw_gate.baseline.match import draw_trials
    from nw_gate.results.provenance import search_key
    from nw_policies import load_bundle

    robot = request.robot
    if robot is None:
        assert request.policy is not None, "a policy is always named"
        robot = load_bundle(request.policy, checkpoint=request.checkpoint).card.robot
    # A search may ask for all of its trials at one rung.
    each = min(most, MAX_TRIALS // len(family.rungs))
    settings: dict[str, Any] = {
        "nw-eval": 1,
        "name": f"limits-{_plain(family.name)}"[:_LONGEST_NAME].rstrip("-."),
        "robot": robot,
        "policy": request.policy,
        "trials": each,
        "seed": request.seed,
        "episode": {"duration": _DURATION, "contact_termination": not contacts},
        "scenes": tuple(dict.fromkeys(rung.scene for rung in family.rungs)),
    }
    if family.rungs[0].perturbation:
        ((axis, _),) = family.rungs[0].perturbation
        settings["perturb"] = {axis: [rung.value for rung in family.rungs]}
    suite = new_suite(settings)
    changes = {field.name: getattr(request, field.name) for field in fields(request)}
    found = plan(suite, **{**changes, "suite": None})
    key = policy_info(found.bundle).key
    strata = [(scene.name, cell) for scene in found.scenes for cell in found.suite.perturb.cells]
    order = draw_trials(strata, each, each, candidate=key, suite_digest=found.suite.digest)
    return replace(
        found,
        trials=expand(found.suite, found.scenes, order),
        drawn=DrawnOrder(starts=each, candidate=search_key(key)),
    )


class _Climb:
    """A search, as `engine.session` asks it what comes next."""

    def __init__(self, plan: Plan, family: SceneLadder, search: LimitSearch, how: How) -> None:
        from nw_eval.engine.machine import worker_count

        self._plan = plan
        self._search = search
        self._workers = worker_count(how.workers, len(plan.trials))
        names = {found.reference: found.scene.name for found in plan.found}
        rungs = {
            (names.get(rung.scene, rung.scene), rung.perturbation): number
            for number, rung in enumerate(family.rungs)
        }
        self._places = {
            LimitTrial(rungs[trial.scene, trial.perturbation], trial.index): trial.place
            for trial in plan.trials
            if trial.place is not None
        }
        self._known = {place: trial for trial, place in self._places.items()}
        self._rows: dict[int, Row] = {}
        self.errors = 0

    def carry_out(self, how: How, out: Path) -> bool:
        """Run what the search asks for; return whether a signal came first."""
        from nw_eval.engine import session
        from nw_gate.results.provenance import read_run_info

        folder = session.carry_out(self._plan, how, out=out, comparison=self)
        return read_run_info(folder.run_json).interrupted

    def beside(self) -> list[tuple[Row, str]]:
        """Return a completed trial at the hardest cleared rung, and a failed one behind it.

        Each has its rung's value, for people. Where there is none at such a rung the nearest one
        stands for it.
        """
        limit = self._search.limit
        ends = dict(zip((True, False), limit.ends, strict=True))
        found: list[tuple[Row, str]] = []
        for completed, end in ends.items():
            rows = [
                (abs(rung - end), place, rung)
                for place in self._counted()
                if self._rows[place].completed is completed
                for rung in [self._known[place].rung]
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
            if row.status == "ok":
                self._search.tell(self._known[place], row.completed)
            else:
                self.errors += 1
        counted, needed = self._counted(), self._search.next
        word = "decided" if self._search.limit.decided else "undecided"
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

    def _counted(self) -> tuple[int, ...]:
        """Return where the trials stand on the search's path: others ran ahead for nothing."""
        counts: dict[int, int] = {}
        found: list[int] = []
        for rung, _ in self._search.trials:
            number = counts.get(rung, 0)
            counts[rung] = number + 1
            found.append(self._places[LimitTrial(rung, number)])
        return tuple(sorted(found))


def _title(family: SceneLadder) -> str:
    """Return what the rungs of a ladder are; the title of an axis says its parameter already."""
    return family.title if "+" in family.name else f"{family.title}: {family.parameter}"


def _plain(name: str) -> str:
    """Return a ladder's name as a suite or a folder may be called."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-.")


def limits_dict(found: FoundLimits) -> dict[str, Any]:
    """Return limits as `limits.json` has them: of numbers, texts, lists and None alone."""
    return {
        "nw-limits": 1,
        "limits": [
            {
                "policy": each.policy,
                "ladder": each.ladder,
                "title": each.title,
                "unit": each.limit.ladder.unit,
                "lower": None if each.limit.lower is None else each.limit.lower.value,
                "upper": None if each.limit.upper is None else each.limit.upper.value,
                "decided": each.limit.decided,
                "trials": len(each.limit.trials),
                "errors": each.errors,
                "says": each.limit.sentence,
                "run": each.run.relative_to(found.out).as_posix(),
                "limit": each.limit.as_dict(),
            }
            for each in found.limits
        ],
    }


def _write_json(found: FoundLimits, path: Path) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(limits_dict(found), indent=1) + "\n", encoding="utf-8")
