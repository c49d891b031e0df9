"""From a run to a baseline, and what is wrong with one: what would make of it another baseline."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from functools import lru_cache
from operator import attrgetter
from typing import Any

from nw_eval.clean import clean
from nw_eval.errors import IncomparableError, TrialError
from nw_eval.plural import plural
from nw_eval.results.bank import (
    BankPolicy,
    BaselineResults,
    Manifest,
    Panel,
    PanelInfo,
    Start,
    Stratum,
    key_of,
    machine_of,
    trajectory,
)
from nw_eval.results.column import (
    NamedColumns,
    Settings,
    all_as_kept,
    as_kept,
    mistyped,
    out_of_bounds,
)
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import COLUMNS, Row, contradiction_of_end, rows_digest
from nw_eval.words import OUTCOMES


def bank_of_run(
    rows: Sequence[Row], run: RunInfo, *, name: str, card: str = "", by: str = "", note: str = ""
) -> BaselineResults:
    """Return the baseline that a finished run is: every start of its seed set has a result.

    Args:
        rows: those of the run's plan, in any order.
        run: what they are of.
        name: the baseline's.
        card: `BankPolicy.card`.
        by: `PanelInfo.by`.
        note: `Manifest.note`.

    Raises:
        TrialError: a trial has no result.
        IncomparableError: the run is not of M starts, 0 to M - 1, in each of its scenes, or of a
            panel of its own.
    """
    if run.panel != "pinned":
        raise IncomparableError(
            f"run {run.id} makes no baseline: it met fresh starts of its own, as no other run does",
            fix="save one from a run on the pinned seed set",
        )
    if errors := [row for row in rows if row.status == "error"]:
        first = min(errors, key=lambda row: row.trial_id)
        raise TrialError(
            f"{len(errors)} of {plural(len(rows), 'trial')} of run {run.id} came to no result, "
            f"first {first.trial_id}: {first.error_text or first.outcome}",
            fix="try them again: the same command, or `nw-eval run --resume`",
        )
    if len(rows) < (planned := sum(run.planned.values())):
        raise TrialError(
            f"run {run.id} has {len(rows)} of its {plural(planned, 'trial')}",
            fix="finish it: the same command, or `nw-eval run --resume`",
        )
    starts = sorted((_start(row) for row in rows), key=place_of)
    machine = machine_of(run)
    manifest = Manifest(
        bank=1,
        name=name,
        suite=str(run.suite.get("name", "")),
        note=clean(note, at_most=500),
        starts=len(starts) // max(1, len({start.stratum for start in starts})) or 1,
        key=key_of(run),
        policy=BankPolicy(
            name=run.policy.name,
            card_digest=run.policy.card_digest,
            checkpoint_digest=run.policy.checkpoint_digest,
            card=card,
        ),
        scores=tuple(run.scores),
        panels=(
            PanelInfo(
                machine=machine,
                saved=run.finished or run.started,
                by=clean(by, at_most=100),
                rows_digest=rows_digest(rows),
            ),
        ),
    )
    bank = BaselineResults(
        manifest=manifest, panels=(Panel(machine=machine, starts=tuple(starts)),)
    )
    if fault := fault_of(bank):
        raise IncomparableError(
            f"run {run.id} makes no baseline: {fault}",
            fix="save one from a run without a baseline, of all of the suite's scenes",
        )
    return bank


def with_panel(bank: BaselineResults, other: BaselineResults) -> BaselineResults:
    """Return a baseline and another one's results, of the same key, policy and starts.

    Args:
        bank: the baseline.
        other: of other classes of machine.
    """
    infos = (*bank.manifest.panels, *other.manifest.panels)
    return replace(
        bank,
        manifest=bank.manifest.model_copy(
            update={
                "panels": infos,
                "scores": tuple(x for x in bank.manifest.scores if x in other.manifest.scores),
            }
        ),
        panels=(*bank.panels, *other.panels),
    )


def _start(row: Row) -> Start:
    return Start(**{name: getattr(row, name) for name in SHARED}, trajectory=trajectory(row))


MOST_PANELS = 64
"""Classes of machines of one baseline."""

SHARED = NamedColumns(
    {field.name: COLUMNS[field.name] for field in fields(Start) if field.name in COLUMNS}
)
SHARED["success"] = replace(SHARED["success"], kind=float)  # A baseline has no errors.
"""The columns that a start has of its row."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
"""As `suite.model.Name`: what is fit for a file anywhere."""

_END = attrgetter(
    *("success", "completed", "outcome", "waypoints_reached", "waypoints_total", "perturbation"),
    "task_kind",
)

_TRAJECTORY = re.compile(r"[0-9a-f]{16}")


def fault_of_name(name: str) -> str | None:
    """Return what is wrong with the name of a baseline or a suite, or None."""
    if _NAME.fullmatch(name):
        return None
    return f"{clean(name, at_most=80)!r} is no name (letters, digits, '_', '-', '.')"


def place_of(start: Start) -> tuple[Stratum, int]:
    """Return by what the starts of a seed set are sorted."""
    return start.stratum, start.seed_index


def fault_of(bank: BaselineResults) -> str | None:
    """Return the first thing that is wrong with a baseline, or None."""
    fault = _fault_of_manifest(bank.manifest) or _fault_of_machines(bank)
    if fault is not None:
        return fault
    for panel in bank.panels:
        if fault := _fault_of_panel(panel, bank.manifest):
            return fault
    if any(panel.by_stratum.keys() != bank.panels[0].by_stratum.keys() for panel in bank.panels):
        return "its machines' results differ in their perturbations"
    return None


def _fault_of_manifest(manifest: Manifest) -> str | None:
    if fault := fault_of_name(manifest.name) or fault_of_name(manifest.suite):
        return fault
    for text in _texts(manifest.model_dump(mode="json")):
        if clean(text) != text:
            return f"its manifest has {clean(text, at_most=80)!r}, which is no plain line"
    return None


def _fault_of_machines(bank: BaselineResults) -> str | None:
    machines = [panel.machine for panel in bank.panels]
    if len(machines) > MOST_PANELS:
        return f"it has {len(machines)} panels, over {MOST_PANELS}"
    if machines != [panel.machine for panel in bank.manifest.panels]:
        return "its results are not those that its manifest lists"
    if any(machine in machines[:place] for place, machine in enumerate(machines)):
        return "it has two sets of results from one class of machine"
    return None


def _fault_of_panel(panel: Panel, manifest: Manifest) -> str | None:
    """Return what is wrong with one panel: a start, their numbers, their scenes, their order."""
    table = {name: [getattr(start, name) for start in panel.starts] for name in SHARED}
    if not all_as_kept(table, SHARED) or not _are_consistent(panel.starts):
        for start in panel.starts:
            if fault := _fault_of_start(start):
                return f"start {start.seed_index} of {clean(start.scene, at_most=80)}: {fault}"
    if fault := _fault_of_scenes({start.scene for start in panel.starts}, set(manifest.key.scenes)):
        return fault
    for stratum, starts in panel.by_stratum.items():
        if fault := _fault_of_indexes([start.seed_index for start in starts], manifest.starts):
            return f"{_shown(stratum)}: {fault}"
    cells: dict[str, set[Settings]] = {}
    for scene, cell in panel.by_stratum:
        cells.setdefault(scene, set()).add(cell)
    if any(found != cells[panel.starts[0].scene] for found in cells.values()):
        return "its scenes differ in what is perturbed"
    if list(panel.starts) != sorted(panel.starts, key=place_of):
        return "its starts are not in the order of scene, perturbation and index"
    return None


def _are_consistent(starts: Iterable[Start]) -> bool:
    """Say whether no start contradicts itself, by one of each kind: most end in a few ways."""
    kinds = {_END(start): start for start in starts}
    return not any(map(_contradiction, kinds.values())) and all(
        _TRAJECTORY.fullmatch(start.trajectory) for start in starts
    )


def _fault_of_start(start: Start) -> str | None:
    values = {name: getattr(start, name) for name in SHARED}
    if fault := mistyped(values, SHARED):
        return fault
    kept = as_kept(values, SHARED)
    if unclean := next((name for name, value in kept.items() if value != values[name]), None):
        return f"{unclean} {clean(values[unclean], at_most=80)!r} is no plain line"
    return _contradiction(start) or out_of_bounds(values, SHARED)


def _contradiction(start: Start) -> str | None:
    """Return in what values that are all right alone make no result together, or None."""
    if not 0.0 <= start.success <= 1.0:
        return f"success {start.success} is not between 0 and 1"
    if start.completed != (start.success == 1.0):
        return f"completed is {start.completed} at success {start.success}"
    if start.outcome not in OUTCOMES:
        return f"outcome {start.outcome!r} is none of {', '.join(OUTCOMES)}"
    reached, total = start.waypoints_reached, start.waypoints_total
    if reached > total:
        return f"{reached} of {total} waypoints reached"
    ended = contradiction_of_end(
        start.outcome,
        reached,
        total,
        start.success,
        completed=start.completed,
        kind=start.task_kind,
    )
    if ended is not None:
        return ended
    axes = tuple(axis for axis, _ in start.perturbation)
    if not _are_names(axes):
        return f"perturbation {clean([*axes], at_most=80)} has an axis twice, or no plain line"
    if not _TRAJECTORY.fullmatch(start.trajectory):
        return f"its trajectory {clean(start.trajectory, at_most=40)!r} is not 16 hex digits"
    return None


@lru_cache(maxsize=64)  # All scenes have the same ones.
def _are_names(axes: tuple[str, ...]) -> bool:
    return len({*axes}) == len(axes) and all(clean(axis) == axis for axis in axes)


def _fault_of_scenes(found: set[str], keyed: set[str]) -> str | None:
    if lacking := sorted(keyed - found):
        return f"it has no start in scene {clean(lacking[0], at_most=80)} of its manifest"
    if foreign := sorted(found - keyed):
        return f"scene {clean(foreign[0], at_most=80)} is none of its manifest"
    return None


def _fault_of_indexes(found: list[int], starts: int) -> str | None:
    """Return in what indexes are not 0 to `starts` - 1, each once."""
    index, times = Counter(found).most_common(1)[0]
    if times > 1:
        return f"start {index} is there {times} times"
    if len(found) != starts:
        return f"{plural(len(found), 'start')}, its manifest says {starts}"
    if max(found) != starts - 1:
        return f"start {max(found)} is not between 0 and {starts - 1}"
    return None


def _shown(stratum: Stratum) -> str:
    scene, cell = stratum
    return clean(" ".join([scene, *(f"{axis}={value!r}" for axis, value in cell)]), at_most=120)


def _texts(value: Any) -> Iterable[str]:
    """Yield every text of a JSON value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for key, item in value.items():
            yield key
            yield from _texts(item)
    elif isinstance(value, list):
        for item in value:
            yield from _texts(item)
