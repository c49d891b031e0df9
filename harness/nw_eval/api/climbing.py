"""How far a policy can go: on each ladder the hardest rung that it still completes, with bounds.

A ladder is a row of scenes from easy to hard, or one scene under ever more of a perturbation. The
search in `nw_gate.limits` says after each result which trial is needed next. Trials run in the
order that results alone decide, so that a limit is the same for one worker and for many.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.errors import NwEvalError, UsageError
from nw_base.files.cache import atomic_path
from nw_eval.api.ladder_runs import Climb, folder_names, ladder_plan, rungs_ladder, title_of
from nw_eval.api.paths import as_path
from nw_eval.api.proposals import write_limits_suite
from nw_eval.api.sweeping import result_folder
from nw_eval.engine.how import How
from nw_eval.reporting.html.limits import LadderLimit, RungFilm, film_bytes, write_limits
from nw_gate.limits.find import LimitSearch
from nw_gate.results.request import Request

if TYPE_CHECKING:
    from os import PathLike

    from nw_eval.engine.plan import Plan
    from nw_sim.ladders import Ladder as SceneLadder

MOST = 120
"""Trials of a ladder, at most: three measured ladders took 20 to 45."""
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
    not_in_suite: tuple[str, ...] = ()
    """Ladders of which a written suite has no rung: their limits lack a bound, or their rungs are
    no scenes."""


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
    write_suite: str | PathLike[str] | None = None,
    allow_code: bool = False,
    contacts: bool = False,
    films: bool = True,
    **how: Any,
) -> FoundLimits:
    """Find the hardest rung of each ladder that a policy still completes, with bounds.

    Both bounds hold whenever the search ends. A rung counts as cleared if the policy completes at
    least `share` of its trials there.

    Args:
        ladders: names or globs of ladders, such as `hurdles/bar` or `hurdles/three_low+payload`,
            folders with a ladder.yaml, or suites whose gate judges ladders (default: all built-in
            ladders of scenes).
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
        write_suite: file to write a suite of the rungs around the limits to; it takes the file's
            name.
        allow_code: allow Python code of the policy's card (confined).
        contacts: let a trial continue when head or trunk touch something, which ends it otherwise.
            Policies without cameras often find obstacles by touching them.
        films: show a trial on either side of each limit on the page; this takes some seconds for
            each ladder, after all limits are found.
        how: fields of `How` by name: workers, cache, listener, labels.

    Raises:
        UsageError: there is no such ladder, or an option cannot be used; nothing was run. Or there
            is no limit to write a suite of.
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
    file = as_path(write_suite)
    if file is not None and all(family.rungs[0].perturbation for family in families):
        raise UsageError(
            f"--write-suite {file}: rungs of {families[0].name} are perturbations, no scenes",
            fix="name a ladder of scenes, or drop --write-suite",
        )
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
        (family, [ladder_plan(family, each, trials, contacts=contacts) for each in rivals])
        for family in families
    ]
    labels = _labels(plans[0][1])
    folder = result_folder(as_path(out), "limits")
    names = folder_names([family.name for family in families])
    found: list[LadderLimit] = []
    results: list[Climb] = []
    whole = FoundLimits(out=folder, limits=(), interrupted=False)
    climbs = [
        (family, label, planned, folder / name / f"{number}")
        for (family, both), name in zip(plans, names, strict=True)
        for number, (label, planned) in enumerate(zip(labels, both, strict=True), 1)
    ]
    for family, label, planned, run in climbs:
        search = _search(family, share, confidence, width, trials)
        climb = Climb(planned, family, search, means)
        interrupted = climb.carry_out(run)
        results.append(climb)
        found.append(
            LadderLimit(
                policy=label,
                ladder=family.name,
                title=title_of(family),
                limit=search.limit,
                run=run,
                errors=climb.errors,
            )
        )
        # Written after each: what ends a later search costs no earlier one.
        whole = replace(whole, limits=tuple(found), interrupted=interrupted)
        _write_json(whole, folder / "limits.json")
        write_limits(whole.limits, folder)
        if interrupted:
            return whole
    if films:
        shown, remarks = _filmed(whole.limits, results, cache=means.cache)
        whole = replace(whole, limits=shown)
        write_limits(shown, folder, remarks)
    if file is None:
        return whole
    left = write_limits_suite(
        file,
        [each for each in whole.limits if each.policy == labels[0]],
        robot=robot or plans[0][1][0].bundle.card.robot,
        policy=policy,
        seed=seed,
    )
    return replace(whole, not_in_suite=left)


def _filmed(
    limits: Sequence[LadderLimit], climbs: Sequence[Climb], *, cache: bool
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


def _families(names: Sequence[str]) -> list[SceneLadder]:
    """Return the ladders that are meant; the built-in ones where none is named.

    Raises:
        UsageError: a suite names no ladder.
        SuiteError: a suite cannot be read.
        SceneError: there is no such ladder, or a folder's cannot be read.
    """
    from fnmatch import fnmatchcase

    from nw_base.files.shipped import available
    from nw_sim.ladders import ladder_named, ladders

    known = ladders()
    found: list[SceneLadder] = []
    suites = available("suites")
    for name in names:
        if name in suites or name.endswith((".yaml", ".yml")):
            found += _families_of_suite(name)
            continue
        matching = [each for each in known if fnmatchcase(each.name, name)]
        found += matching or [ladder_named(name)]
    if not names:
        found = [each for each in known if "+" not in each.name]
    return list({each.name: each for each in found}.values())


def _families_of_suite(name: str) -> list[SceneLadder]:
    """Return the ladders that the gate of a suite judges.

    Raises:
        UsageError, SuiteError, SceneError: as `_families`.
    """
    from nw_eval.suite import load_suite
    from nw_sim.ladders import ladder_named

    suite = load_suite(name)
    if not suite.gate.limits:
        raise UsageError(
            f"the gate of suite {name} names no ladder",
            fix="name ladders, or add `gate.limits` to the suite",
        )
    return [ladder_named(each, suite.base) for each in suite.gate.limits]


def _search(
    family: SceneLadder, share: float, confidence: float, width: int, most: int
) -> LimitSearch:
    return LimitSearch(
        rungs_ladder(family), share=share, confidence=confidence, width=width, most=most
    )


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
