"""Where a bank lies that is asked for by name: in the project, or among the shipped ones."""

from __future__ import annotations

from pathlib import Path

from nw_eval.errors import IncomparableError, UsageError, nearest
from nw_eval.files.inside import what_is
from nw_eval.files.shipped import shipped
from nw_eval.results.bank.file import SUFFIX

BANKS = Path("reports/baselines")
"""Where a project keeps its banks, a folder for each suite."""


def find_bank(reference: str | Path, *, suite: str, root: Path = BANKS) -> Path:
    """Return the file of a bank.

    Args:
        reference: a name, also as `<suite>/<name>`; or a path, which has a slash or ends with
            `.parquet`.
        suite: the name of the suite, whose folder a name is looked for in.
        root: the project's folder of banks, which comes before the shipped ones.

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
    """Return the file of a bank whose suite need not be known.

    Args:
        reference: a path; `<suite>/<name>`; or a name alone.
        suite: the suite's name, where several have a bank of that name.
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
        suites = [suite]  # Whose bank it is not, if it has none.
    elif folder:
        suites = [each for each in suites if each == folder]
    if len(suites) > 1:
        listed = ", ".join(f"{each}/{name}" for each in suites)
        raise UsageError(f"several suites have a baseline {name!r}", fix=f"name one: {listed}")
    if not suites:
        known = [f"{path.parent.name}/{path.stem}" for path in banks]
        raise UsageError(f"no baseline {text!r}", fix=nearest(text, known))
    return find_bank(name, suite=suites[0], root=root)


def bank_files(suite: str | None = None, *, root: Path = BANKS) -> tuple[Path, ...]:
    """Return the files of all banks, the project's before the shipped ones; of one suite if named.

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
