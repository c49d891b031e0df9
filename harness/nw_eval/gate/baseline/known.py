"""What the baseline scored: as rows, and beside trials of its own policy that run again."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from nw_eval.errors import StoreError
from nw_eval.gate.verdict import Recheck
from nw_eval.plural import plural
from nw_eval.results.bank import BaselineResults, Panel, Start, machine_of, trajectory
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row, from_dict
from nw_eval.suite.model import new_suite
from nw_eval.suite.trials import expand

_NAMED = 3  # trials, and values of each, that the sentences name

FROM_START = (
    *("success", "completed", "outcome", "end_reason"),
    *("waypoints_reached", "waypoints_total"),
)
"""Columns of a row that a baseline has of each start."""

_NO_TIMES = dict.fromkeys(("physics_s", "render_s", "policy_s", "log_s", "wall_s"), 0.0)


@dataclass(frozen=True, kw_only=True)
class _Place:
    """A scene, as its trials' identities need it."""

    name: str
    task: str
    digest: str


def known_rows(run: RunInfo, bank: BaselineResults) -> tuple[Row, ...]:
    """Return a baseline's results as rows, taken over (`Row.cached`): they cost this run no time.

    They are for judging only. What a baseline does not hold of a trial, its steps and digests, they
    do not hold either.

    Args:
        run: of the baseline's own policy.
        bank: which fits the run: the results of its class of machine, or else the first.
    """
    panel = bank.panel_of(machine_of(run)) or bank.panels[0]
    starts = {(*start.stratum, start.seed_index): start for start in panel.starts}
    suite = new_suite({**run.suite, "trials": bank.manifest.starts})
    scenes = [_Place(name=name, task=s.task, digest=s.digest) for name, s in run.scenes.items()]
    rows: list[Row] = []
    for trial in expand(suite, scenes):
        start = starts[trial.scene, trial.perturbation, trial.index]
        known = {
            "trial_id": trial.id,
            "suite": trial.suite,
            "scene": trial.scene,
            "task": trial.task,
            "robot": run.suite["robot"],
            "tier": trial.tier,
            "seed_index": trial.index,
            "seed": trial.seed,
            "policy": run.policy.name,
            "arm": "baseline",
            "perturbation": trial.perturbation,
            "status": "ok",
            "steps": 0,
            "sim_s": 0.0,
            "checkpoint_digest": run.policy.checkpoint_digest,
            "scene_digest": trial.scene_digest,
            "cached": True,
            **{name: getattr(start, name) for name in FROM_START},
            "task_kind": start.task_kind,
            "scores": start.scores,
            **_NO_TIMES,
        }
        rows.append(from_dict(known))
    return tuple(rows)


def recheck(rows: Sequence[Row], run: RunInfo, bank: BaselineResults) -> Recheck:
    """Compare trials of the baseline's own policy with what the baseline says of these starts.

    On a class of machine that the baseline has been run on, values and bits must be equal. On
    another one bits may be others. Then nothing is reused, and only a trial that has the
    baseline's bits and another result speaks against the baseline.

    Args:
        rows: of the run, whose policy is the baseline's by its digests, on the pinned seed set.
        run: what they are of.
        bank: of the baseline.

    Raises:
        StoreError: a row is of no start of the baseline.
    """
    seen = bank.panel_of(machine_of(run))
    done = [row for row in rows if row.status == "ok"]
    # The results that `known_rows` uses.
    panel = seen or bank.panels[0]
    differing = differences(done, panel)
    ran = {(row.scene, row.perturbation) for row in done if not row.cached}
    strata = {(row.scene, row.perturbation) for row in rows}
    planned = sum(run.planned.values())
    wrong = contradictions(done, bank, panel)
    if differing and seen is not None:
        count = f"{len(differing)} of {plural(len(done), 'trial')}"
        more = len(differing) - _NAMED
        rest = f"and {plural(more, 'more trial')}; `nw-eval baseline verify` names all"
        wrong = (
            f"the baseline {bank.manifest.name} is not what its own policy does: {count} differ",
            *differing[:_NAMED],
            *([rest] if more > 0 else []),
        )
    return Recheck(
        compared=len(done),
        ran=sum(not row.cached for row in done),
        equal=not differing,
        differing=wrong,
        taken_over=run.is_recheck
        and run.stop is not None
        and not differing
        and 0 < planned == len(done)
        and ran == strata,
    )


def contradictions(rows: Iterable[Row], bank: BaselineResults, panel: Panel) -> tuple[str, ...]:
    """Return sentences where trials have the bits of a baseline, and another result; or nothing.

    The same states and actions are the same trial: its result is no matter of the machine.

    Args:
        rows: with results, of the baseline's own policy.
        bank: of the baseline.
        panel: of it.

    Raises:
        StoreError: a row is of no start of the baseline.
    """
    same = [row for row in rows if trajectory(row) == _start_of(row, panel).trajectory]
    found = differences(same, panel)
    if not found:
        return ()
    own = bank.manifest.policy.name
    first = f"the baseline is not what its own policy {own} does: the same bits, other results"
    return (first, *found[:_NAMED])


def differences(rows: Iterable[Row], panel: Panel) -> tuple[str, ...]:
    """Return a sentence for each trial that differs from a baseline, by scene and start.

    Args:
        rows: with results, of the baseline's own policy.
        panel: what the baseline says.

    Raises:
        StoreError: a row is of no start of the baseline.
    """
    found: list[tuple[Start, str]] = []
    for row in rows:
        start = _start_of(row, panel)
        if (text := difference(row, start)) is not None:
            found.append((start, text))
    found.sort(key=lambda item: (item[0].stratum, item[0].seed_index))
    return tuple(text for _, text in found)


def difference(row: Row, start: Start) -> str | None:
    """Return what of a trial is not as the baseline says, both values of each; None if nothing.

    Args:
        row: with a result.
        start: what the baseline says of it.
    """
    pairs = [(name, getattr(start, name), getattr(row, name)) for name in FROM_START]
    parts = [f"{name} {now}, the baseline's {then}" for name, then, now in pairs if then != now]
    if not parts and trajectory(row) != start.trajectory:
        parts = [f"bits {trajectory(row)}, the baseline's {start.trajectory}"]
    elif not parts:
        # Of the same states, but sums of them may end in other bits on another CPU.
        said = dict(start.scores)
        parts = [
            f"{name} {now:g}, the baseline's {said[name]:g}"
            for name, now in row.scores
            if name in said and not math.isclose(now, said[name], rel_tol=1e-9, abs_tol=1e-12)
        ]
    if not parts:
        return None
    cell = "".join(f" {axis} {value:g}" for axis, value in start.perturbation)
    # The first says most: the others follow from it.
    return f"scene {start.scene}{cell} start {start.seed_index}: {', '.join(parts[:_NAMED])}"


def _start_of(row: Row, panel: Panel) -> Start:
    starts = panel.by_stratum.get((row.scene, row.perturbation), ())
    if not 0 <= row.seed_index < len(starts):
        raise StoreError(
            f"trial {row.trial_id} is of no start of the baseline, which has {len(starts)} in "
            "its scene",
            fix="judge the run against the baseline that it was begun with",
        )
    return starts[row.seed_index]
