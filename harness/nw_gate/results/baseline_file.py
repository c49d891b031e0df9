"""A baseline as one Parquet file: its starts are the table, its manifest is in the metadata.

It is made from a run, and looked at for what would make of it another baseline (`fault_of`).

Whoever made it, it is read by a process of its own (`tables`) and then looked at as a whole: what
it says of scenes, starts and machines must be what it holds. One that is asked for by name lies in
the project, or among the shipped ones.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from nw_base.clean import clean
from nw_base.errors import IncomparableError, StoreError, TrialError, UsageError, nearest
from nw_base.files.inside import what_is
from nw_base.files.shipped import shipped
from nw_base.plural import plural
from nw_base.words import OUTCOMES
from nw_gate.limits.limit import Limit
from nw_gate.results.baseline import (
    BaselinePolicy,
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
from nw_gate.results.column import (
    NamedColumns,
    Settings,
    as_kept,
    mistyped,
    out_of_bounds,
)
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import COLUMNS, Row, contradiction_of_end, rows_digest
from nw_gate.results.tables import PlainTable, read_small_table, write_small_table

if TYPE_CHECKING:
    import pyarrow as pa

VERSION = 1
"""`Manifest.bank`, raised when a field or a column changes its meaning."""

SUFFIX = ".parquet"
_MANIFEST = "bank"
_RESTORE = "restore it from git, or replace it: `nw-eval baseline save` with --renew"


def write_baseline(path: Path, baseline: BaselineResults) -> None:
    """Write a baseline. Equal baselines give equal bytes with one version of Arrow.

    Args:
        path: `<name of the baseline>.parquet`; appears whole or not at all.
        baseline: starts in the order of scene, perturbation and index.

    Raises:
        StoreError: it cannot be written, or could not be read again.
    """
    if fault := fault_of(baseline) or _misnamed(path, baseline.manifest):
        raise StoreError(f"cannot write {path}: {fault}", fix="save the baseline again from a run")
    content = baseline.manifest.model_dump(mode="json")
    for later in ("scores", "limits"):
        if not content[later]:
            del content[later]  # An older baseline stays as it is.
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    write_small_table(path, baseline_table(baseline), {_MANIFEST: text})


def baseline_table(baseline: BaselineResults) -> pa.Table:
    """Return the starts of all machines' results, one after another, as an Arrow table.

    Its columns are the number of the class of machine in the manifest, those of a row, and the
    bytes of the trajectory.
    """
    import pyarrow as pa

    from nw_gate.results.parquet import SCHEMA

    # A column that came later is there if it says anything: older baselines stay as they are.
    starts = [start for panel in baseline.panels for start in panel.starts]
    names = [
        name
        for name, column in SHARED.items()
        if not column.added or any(getattr(start, name) != column.default for start in starts)
    ]
    schema = pa.schema(
        [
            pa.field("panel", pa.int32(), nullable=False),
            *(pa.field(name, SCHEMA.field(name).type, nullable=False) for name in names),
            pa.field("trajectory", pa.binary(8), nullable=False),
        ]
    )
    lines = [
        {
            "panel": number,
            **{name: getattr(start, name) for name in names},
            "trajectory": bytes.fromhex(start.trajectory),
        }
        for number, panel in enumerate(baseline.panels)
        for start in panel.starts
    ]
    return pa.Table.from_pylist(lines, schema=schema)


def read_baseline(path: Path) -> BaselineResults:
    """Read a baseline, which may be untrusted.

    Raises:
        UsageError: there is none.
        StoreError: it is damaged, too large, or cannot be read.
        IncomparableError: it is whole, but no baseline, or of another version; or it has no number
            where one belongs, a start twice or missing, other scenes or machines than its manifest
            says, or another name than its file.
    """
    if what_is(path) != "file":
        raise UsageError(f"no baseline at {path}", fix="`nw-eval baseline list` lists them")
    return baseline_of(read_small_table(path, fix=_RESTORE), path)


def baseline_of(table: PlainTable, path: Path) -> BaselineResults:
    """Return the baseline that a table is, if it is one.

    Args:
        table: as it was read.
        path: of its file.

    Raises:
        IncomparableError: as `read_baseline`.
    """
    manifest = _manifest(table.metadata.get(_MANIFEST), path)
    needed = [name for name, column in SHARED.items() if not column.added]
    needed.append("trajectory")
    if missing := [name for name in ("panel", *needed) if name not in table.columns]:
        raise _unusable(path, f"it lacks the columns {', '.join(missing)}")
    groups: list[list[Start]] = [[] for _ in manifest.panels[: MOST_PANELS + 1]]
    for number, start in zip(table.columns["panel"], _starts(table, path), strict=True):
        if not (isinstance(number, int) and 0 <= number < len(groups)):
            raise _unusable(path, f"it has results of machine {number}, of {len(groups)} listed")
        groups[number].append(start)
    panels = [
        Panel(machine=info.machine, starts=tuple(starts))
        for info, starts in zip(manifest.panels, groups, strict=False)
    ]
    baseline = BaselineResults(manifest=manifest, panels=tuple(panels))
    if fault := fault_of(baseline):
        raise _unusable(path, fault)
    if fault := _misnamed(path, manifest):
        raise IncomparableError(
            f"{path} cannot be compared with: {fault}",
            fix=f"call the file {manifest.name}{SUFFIX}, or save a baseline of the other name",
        )
    return baseline


def _manifest(text: str | None, path: Path) -> Manifest:
    if text is None:
        raise IncomparableError(
            f"{path} is not a baseline file",
            fix="save one from a run with `nw-eval baseline save SUITE --run RUN`",
        )
    try:
        content = json.loads(text)
        version = content.get("bank") if isinstance(content, dict) else None
        if version != VERSION:
            raise IncomparableError(
                f"{path} is a baseline of version {clean(version, at_most=40)}, "
                f"this nw-eval reads {VERSION}",
                fix="use the version of nw-eval that wrote it, or save it again",
            )
        return Manifest.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        location = ".".join(str(part) for part in ("manifest", *first["loc"]))
        raise _unusable(path, clean(f"{location}: {first['msg'].lower()}", at_most=300)) from None
    except (ValueError, RecursionError):
        raise _unusable(path, "its manifest is no JSON") from None


def _starts(table: PlainTable, path: Path) -> Iterable[Start]:
    try:
        values = {
            name: [column.of_plain(value) for value in table.columns[name]]
            if column.is_list
            else table.columns[name]
            for name, column in SHARED.items()
            if name in table.columns
        }
        absent = {name: column.default for name, column in SHARED.items() if name not in values}
    except (TypeError, ValueError):
        raise _unusable(path, "a perturbation holds something that is not a number") from None
    values["trajectory"] = [str(each) for each in table.columns["trajectory"]]
    names = tuple(values)
    for line in zip(*values.values(), strict=True):
        yield Start(**dict(zip(names, line, strict=True)), **absent)


def _misnamed(path: Path, manifest: Manifest) -> str | None:
    if path.name == manifest.name + SUFFIX:
        return None
    return f"its manifest calls it {clean(manifest.name, at_most=80)}, its file is {path.name}"


def _unusable(path: Path, fault: str) -> IncomparableError:
    return IncomparableError(f"{path} cannot be compared with: {fault}", fix=_RESTORE)


BASELINES_FOLDER = Path("reports/baselines")
"""Where a project keeps its baselines, a folder for each suite."""


def find_baseline(reference: str | Path, *, suite: str, root: Path = BASELINES_FOLDER) -> Path:
    """Return the file of a baseline.

    Args:
        reference: a name, also as `<suite>/<name>`; or a path, which has a slash or ends with
            `.parquet`.
        suite: the name of the suite, whose folder a name is looked for in.
        root: the project's folder of baselines, which comes before the shipped ones.

    Raises:
        UsageError: there is none.
        IncomparableError: the project and nw-eval have different baselines of that name.
    """
    name = str(reference)
    if what_is(Path(name)) != "file":
        name = name.removeprefix(f"{suite}/")  # As lists of all suites have it.
    if "/" in name or name.endswith(SUFFIX):
        path = Path(name)
        if what_is(path) != "file":
            raise UsageError(f"no baseline at {path}", fix=_hint(path.stem, suite, root))
        return path
    paths = [
        path
        for folder in _folders(suite, root)
        if what_is(path := folder / (name + SUFFIX)) == "file"
    ]
    if not paths:
        raise UsageError(f"suite {suite!r} has no baseline {name!r}", fix=_hint(name, suite, root))
    if len(paths) > 1 and paths[0].read_bytes() != paths[1].read_bytes():
        raise IncomparableError(
            f"two baselines of suite {suite!r} are called {name!r}: {paths[0]} and {paths[1]}",
            fix="name one of them by its path",
        )
    return paths[0]


def find_any(
    reference: str | Path, *, suite: str | None = None, root: Path = BASELINES_FOLDER
) -> Path:
    """Return the file of a baseline whose suite need not be known.

    Args:
        reference: a path; `<suite>/<name>`; or a name alone.
        suite: the suite's name, where several have a baseline of that name.
        root: as for `find_baseline`.

    Raises:
        UsageError: there is none, or several suites have one.
        IncomparableError: as `find_baseline`.
    """
    text = str(reference)
    if what_is(Path(text)) == "file":
        return Path(text)
    folder, _, name = text.rpartition("/")
    baselines = baseline_files(root=root)
    suites = sorted({path.parent.name for path in baselines if path.stem == name})
    if suite is not None and folder in {"", suite}:
        suites = [suite]  # Whose baseline it is not, if it has none.
    elif folder:
        suites = [each for each in suites if each == folder]
    if len(suites) > 1:
        listed = ", ".join(f"{each}/{name}" for each in suites)
        raise UsageError(f"several suites have a baseline {name!r}", fix=f"name one: {listed}")
    if not suites:
        known = [f"{path.parent.name}/{path.stem}" for path in baselines]
        raise UsageError(f"no baseline {text!r}", fix=nearest(text, sorted(set(known))))
    return find_baseline(name, suite=suites[0], root=root)


def baseline_files(suite: str | None = None, *, root: Path = BASELINES_FOLDER) -> tuple[Path, ...]:
    """Return the files of all baselines, the project's first; of one suite if named.

    A shipped one that the project has, bit for bit, is there once.
    """
    paths: dict[tuple[str, str, bytes], Path] = {}
    for folder in _folders(suite or "*", root):
        for path in sorted(folder.parent.glob(f"{folder.name}/*{SUFFIX}")):
            if what_is(path) == "file":
                paths.setdefault((path.parent.name, path.name, path.read_bytes()), path)
    return tuple(paths.values())


def _folders(suite: str, root: Path) -> tuple[Path, Path]:
    return root / suite, shipped("baselines") / suite


def _hint(name: str, suite: str, root: Path) -> str:
    known = [path.stem for path in baseline_files(suite, root=root)]
    if known:
        return nearest(name, known)
    return f"none is known; `nw-eval baseline save {suite} --policy POLICY` makes one"


def baseline_of_run(
    rows: Sequence[Row],
    run: RunInfo,
    *,
    name: str,
    card: str = "",
    by: str = "",
    note: str = "",
    held_out: bool = False,
) -> BaselineResults:
    """Return the baseline that a finished run is: every start of its seed set has a result.

    Args:
        rows: those of the run's plan, in any order.
        run: what they are of.
        name: the baseline's.
        card: `BaselinePolicy.card`.
        by: `PanelInfo.by`.
        note: `Manifest.note`.
        held_out: `Manifest.held_out`.

    Raises:
        TrialError: a trial has no result.
        IncomparableError: the run is not of M starts, 0 to M - 1, in each of its scenes, or of a
            panel of its own.
    """
    if run.panel != "pinned":
        raise IncomparableError(
            f"run {run.id} makes no baseline: it met fresh initial states of its own, as no "
            "other run does",
            fix="save one from a run on the pinned seed set",
        )
    if errors := [row for row in rows if row.status == "error"]:
        first = min(errors, key=lambda row: row.trial_id)
        raise TrialError(
            f"{len(errors)} of {plural(len(rows), 'trial')} of run {run.id} have no result, "
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
        policy=BaselinePolicy(
            name=run.policy.name,
            card_digest=run.policy.card_digest,
            checkpoint_digest=run.policy.checkpoint_digest,
            card=card,
        ),
        scores=tuple(run.scores),
        held_out=held_out,
        panels=(
            PanelInfo(
                machine=machine,
                saved=run.finished or run.started,
                by=clean(by, at_most=100),
                rows_digest=rows_digest(rows),
            ),
        ),
    )
    baseline = BaselineResults(
        manifest=manifest, panels=(Panel(machine=machine, starts=tuple(starts)),)
    )
    if fault := fault_of(baseline):
        raise IncomparableError(
            f"run {run.id} makes no baseline: {fault}",
            fix="save one from a run without a baseline, of all of the suite's scenes",
        )
    return baseline


def with_panel(baseline: BaselineResults, other: BaselineResults) -> BaselineResults:
    """Return a baseline and another one's results, of the same key, policy and starts.

    Args:
        baseline: the baseline.
        other: of other classes of machine.
    """
    infos = (*baseline.manifest.panels, *other.manifest.panels)
    return replace(
        baseline,
        manifest=baseline.manifest.model_copy(
            update={
                "panels": infos,
                "limits": {**other.manifest.limits, **baseline.manifest.limits},
                "scores": tuple(x for x in baseline.manifest.scores if x in other.manifest.scores),
            }
        ),
        panels=(*baseline.panels, *other.panels),
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

_TRAJECTORY = re.compile(r"[0-9a-f]{16}")


def fault_of_name(name: str) -> str | None:
    """Return what is wrong with the name of a baseline or a suite, or None."""
    if _NAME.fullmatch(name):
        return None
    return f"{clean(name, at_most=80)!r} is not a name (letters, digits, '_', '-', '.')"


def place_of(start: Start) -> tuple[Stratum, int]:
    """Return by what the starts of a seed set are sorted."""
    return start.stratum, start.seed_index


def fault_of(baseline: BaselineResults) -> str | None:
    """Return the first thing that is wrong with a baseline, or None."""
    fault = _fault_of_manifest(baseline.manifest) or _fault_of_machines(baseline)
    if fault is not None:
        return fault
    for panel in baseline.panels:
        if fault := _fault_of_panel(panel, baseline.manifest):
            return fault
    if any(
        panel.by_stratum.keys() != baseline.panels[0].by_stratum.keys() for panel in baseline.panels
    ):
        return "its machines' results differ in their perturbations"
    return None


def _fault_of_manifest(manifest: Manifest) -> str | None:
    if fault := fault_of_name(manifest.name) or fault_of_name(manifest.suite):
        return fault
    for text in _texts(manifest.model_dump(mode="json")):
        if clean(text) != text:
            return f"its manifest has {clean(text, at_most=80)!r}, which is not a plain line"
    for ladder, saved in manifest.limits.items():
        try:
            Limit.from_dict(saved.limit)
        except StoreError as error:
            return f"its limit of ladder {ladder}: {error.message}"
    return None


def _fault_of_machines(baseline: BaselineResults) -> str | None:
    machines = [panel.machine for panel in baseline.panels]
    if len(machines) > MOST_PANELS:
        return f"it has {len(machines)} panels, over {MOST_PANELS}"
    if machines != [panel.machine for panel in baseline.manifest.panels]:
        return "its results are not those that its manifest lists"
    if any(machine in machines[:index] for index, machine in enumerate(machines)):
        return "it has two sets of results from one machine type"
    return None


def _fault_of_panel(panel: Panel, manifest: Manifest) -> str | None:
    """Return what is wrong with one panel: a start, their numbers, their scenes, their order."""
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
    if any(indexes != cells[panel.starts[0].scene] for indexes in cells.values()):
        return "its scenes differ in what is perturbed"
    if list(panel.starts) != sorted(panel.starts, key=place_of):
        return "its initial states are not in the order of scene, perturbation and index"
    return None


def _fault_of_start(start: Start) -> str | None:
    values = {name: getattr(start, name) for name in SHARED}
    if fault := mistyped(values, SHARED):
        return fault
    kept = as_kept(values, SHARED)
    if unclean := next((name for name, value in kept.items() if value != values[name]), None):
        return f"{unclean} {clean(values[unclean], at_most=80)!r} is not a plain line"
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


def _fault_of_scenes(scenes: set[str], keyed: set[str]) -> str | None:
    if lacking := sorted(keyed - scenes):
        return f"it has no start in scene {clean(lacking[0], at_most=80)} of its manifest"
    if foreign := sorted(scenes - keyed):
        return f"scene {clean(foreign[0], at_most=80)} is not in its manifest"
    return None


def _fault_of_indexes(indexes: list[int], starts: int) -> str | None:
    """Return in what indexes are not 0 to `starts` - 1, each once."""
    index, times = Counter(indexes).most_common(1)[0]
    if times > 1:
        return f"start {index} is there {times} times"
    if len(indexes) != starts:
        return f"{plural(len(indexes), 'initial state')}, its manifest says {starts}"
    if max(indexes) != starts - 1:
        return f"start {max(indexes)} is not between 0 and {starts - 1}"
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
