"""A baseline as one Parquet file: its starts are the table, its manifest is in the metadata.

Whoever made it, it is read by a process of its own (`tables`) and then looked at as a whole: what
it says of scenes, starts and machines must be what it holds. One that is asked for by name lies in
the project, or among the shipped ones.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from nw_eval.clean import clean
from nw_eval.errors import IncomparableError, StoreError, UsageError, nearest
from nw_eval.files.inside import what_is
from nw_eval.files.shipped import shipped
from nw_eval.results.bank import BaselineResults, Manifest, Panel, Start
from nw_eval.results.bank_build import MOST_PANELS, SHARED, fault_of
from nw_eval.results.tables import PlainTable, read_small_table, write_small_table

if TYPE_CHECKING:
    import pyarrow as pa

VERSION = 1
"""`Manifest.bank`, raised when a field or a column changes its meaning."""

SUFFIX = ".parquet"
_MANIFEST = "bank"
_RESTORE = "restore it from git, or replace it: `nw-eval baseline save` with --renew"


def write_bank(path: Path, bank: BaselineResults) -> None:
    """Write a baseline. Equal baselines give equal bytes with one version of Arrow.

    Args:
        path: `<name of the baseline>.parquet`; appears whole or not at all.
        bank: starts in the order of scene, perturbation and index.

    Raises:
        StoreError: it cannot be written, or could not be read again.
    """
    if fault := fault_of(bank) or _misnamed(path, bank.manifest):
        raise StoreError(f"cannot write {path}: {fault}", fix="save the baseline anew from a run")
    content = bank.manifest.model_dump(mode="json")
    if not bank.manifest.scores:
        del content["scores"]  # An older baseline stays as it is.
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    write_small_table(path, bank_table(bank), {_MANIFEST: text})


def bank_table(bank: BaselineResults) -> pa.Table:
    """Return the starts of all machines' results, one after another, as an Arrow table.

    Its columns are the number of the class of machine in the manifest, those of a row, and the
    bytes of the trajectory.
    """
    import pyarrow as pa

    from nw_eval.results.parquet import SCHEMA

    # A column that came later is there if it says anything: older banks stay as they are.
    starts = [start for panel in bank.panels for start in panel.starts]
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
        for number, panel in enumerate(bank.panels)
        for start in panel.starts
    ]
    return pa.Table.from_pylist(lines, schema=schema)


def read_bank(path: Path) -> BaselineResults:
    """Read a baseline, which may be untrusted.

    Raises:
        UsageError: there is none.
        StoreError: it is damaged, too large, or cannot be read.
        IncomparableError: it is whole, but no baseline, or of another version; or it has no number
            where one belongs, a start twice or missing, other scenes or machines than its manifest
            says, or another name than its file.
    """
    if what_is(path) != "file":
        raise UsageError(
            f"no baseline at {path}", fix="`nw-eval baseline list` says which there are"
        )
    return bank_of(read_small_table(path, fix=_RESTORE), path)


def bank_of(table: PlainTable, path: Path) -> BaselineResults:
    """Return the baseline that a table is, if it is one.

    Args:
        table: as it was read.
        path: of its file.

    Raises:
        IncomparableError: as `read_bank`.
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
    bank = BaselineResults(manifest=manifest, panels=tuple(panels))
    if fault := fault_of(bank):
        raise _unusable(path, fault)
    if fault := _misnamed(path, manifest):
        raise IncomparableError(
            f"{path} cannot be compared with: {fault}",
            fix=f"call the file {manifest.name}{SUFFIX}, or save a baseline of the other name",
        )
    return bank


def _manifest(text: str | None, path: Path) -> Manifest:
    if text is None:
        raise IncomparableError(
            f"{path} is no baseline",
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
        place = ".".join(str(part) for part in ("manifest", *first["loc"]))
        raise _unusable(path, clean(f"{place}: {first['msg'].lower()}", at_most=300)) from None
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
        raise _unusable(path, "a perturbation holds something that is no number") from None
    values["trajectory"] = [str(each) for each in table.columns["trajectory"]]
    names = tuple(values)
    for line in zip(*values.values(), strict=True):
        # As its own `__init__` would leave it, which takes three times as long.
        start = object.__new__(Start)
        object.__setattr__(start, "__dict__", dict(zip(names, line, strict=True)) | absent)
        yield start


def _misnamed(path: Path, manifest: Manifest) -> str | None:
    if path.name == manifest.name + SUFFIX:
        return None
    return f"its manifest calls it {clean(manifest.name, at_most=80)}, its file is {path.name}"


def _unusable(path: Path, fault: str) -> IncomparableError:
    return IncomparableError(f"{path} cannot be compared with: {fault}", fix=_RESTORE)


BANKS = Path("reports/baselines")
"""Where a project keeps its banks, a folder for each suite."""


def find_bank(reference: str | Path, *, suite: str, root: Path = BANKS) -> Path:
    """Return the file of a baseline.

    Args:
        reference: a name, also as `<suite>/<name>`; or a path, which has a slash or ends with
            `.parquet`.
        suite: the name of the suite, whose folder a name is looked for in.
        root: the project's folder of baselines, which comes before the shipped ones.

    Raises:
        UsageError: there is none.
        IncomparableError: the project and nw-eval have different banks of that name.
    """
    name = str(reference)
    if what_is(Path(name)) != "file":
        name = name.removeprefix(f"{suite}/")  # As lists of all suites have it.
    if "/" in name or name.endswith(SUFFIX):
        path = Path(name)
        if what_is(path) != "file":
            raise UsageError(f"no baseline at {path}", fix=_hint(path.stem, suite, root))
        return path
    found = [
        path
        for folder in _folders(suite, root)
        if what_is(path := folder / (name + SUFFIX)) == "file"
    ]
    if not found:
        raise UsageError(f"suite {suite!r} has no baseline {name!r}", fix=_hint(name, suite, root))
    if len(found) > 1 and found[0].read_bytes() != found[1].read_bytes():
        raise IncomparableError(
            f"two baselines of suite {suite!r} are called {name!r}: {found[0]} and {found[1]}",
            fix="name one of them by its path",
        )
    return found[0]


def find_any(reference: str | Path, *, suite: str | None = None, root: Path = BANKS) -> Path:
    """Return the file of a baseline whose suite need not be known.

    Args:
        reference: a path; `<suite>/<name>`; or a name alone.
        suite: the suite's name, where several have a baseline of that name.
        root: as for `find_bank`.

    Raises:
        UsageError: there is none, or several suites have one.
        IncomparableError: as `find_bank`.
    """
    text = str(reference)
    if what_is(Path(text)) == "file":
        return Path(text)
    folder, _, name = text.rpartition("/")
    banks = bank_files(root=root)
    suites = sorted({path.parent.name for path in banks if path.stem == name})
    if suite is not None and folder in {"", suite}:
        suites = [suite]  # Whose baseline it is not, if it has none.
    elif folder:
        suites = [each for each in suites if each == folder]
    if len(suites) > 1:
        listed = ", ".join(f"{each}/{name}" for each in suites)
        raise UsageError(f"several suites have a baseline {name!r}", fix=f"name one: {listed}")
    if not suites:
        known = [f"{path.parent.name}/{path.stem}" for path in banks]
        raise UsageError(f"no baseline {text!r}", fix=nearest(text, sorted(set(known))))
    return find_bank(name, suite=suites[0], root=root)


def bank_files(suite: str | None = None, *, root: Path = BANKS) -> tuple[Path, ...]:
    """Return the files of all baselines, the project's first; of one suite if named.

    A shipped one that the project has, bit for bit, is there once.
    """
    found: dict[tuple[str, str, bytes], Path] = {}
    for folder in _folders(suite or "*", root):
        for path in sorted(folder.parent.glob(f"{folder.name}/*{SUFFIX}")):
            if what_is(path) == "file":
                found.setdefault((path.parent.name, path.name, path.read_bytes()), path)
    return tuple(found.values())


def _folders(suite: str, root: Path) -> tuple[Path, Path]:
    return root / suite, shipped("baselines") / suite


def _hint(name: str, suite: str, root: Path) -> str:
    known = [path.stem for path in bank_files(suite, root=root)]
    if known:
        return nearest(name, known)
    return f"none is known; `nw-eval baseline save {suite} --policy POLICY` makes one"
