"""Banks that there are, and what they hold: none of this imports a simulator."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.errors import NwEvalError

if TYPE_CHECKING:
    from nw_eval.results.bank import SavedBank
    from nw_eval.results.bank_changes import BankChange

_READERS = 4
"""Files that are read at a time: each by a process of its own, which mostly starts."""


@dataclass(frozen=True, kw_only=True)
class ListedBaseline:
    """A bank, as far as it can be read."""

    file: Path
    suite: str
    """The folder that it lies in."""
    name: str
    bank: SavedBank | None = None
    mean: float | None = None
    """Mean success over scenes."""
    problem: str | None = None
    """Why it cannot be read."""


@dataclass(frozen=True, kw_only=True)
class ShownBaseline:
    """One bank, and where it lies."""

    file: Path
    bank: SavedBank


def list_baselines() -> tuple[ListedBaseline, ...]:
    """Return the project's banks, those of `reports/baselines`, and then the shipped ones."""
    from nw_eval.results.bank_file import bank_files

    with ThreadPoolExecutor(_READERS) as readers:
        return tuple(readers.map(_listed, bank_files()))


def show_baseline(baseline: str | Path, *, suite: str | None = None) -> ShownBaseline:
    """Read one bank.

    Args:
        baseline: its name, `<suite>/<name>` as `list_baselines` has them, or its path.
        suite: the suite's name, where several have a bank of that name.

    Raises:
        UsageError: there is none, or it is not clear which.
        StoreError: it is damaged.
        IncomparableError: it is no bank that anything can be compared with.
    """
    from nw_eval.results.bank_file import find_any, read_bank

    file = find_any(baseline, suite=suite)
    return ShownBaseline(file=file, bank=read_bank(file))


def diff_baselines(then: str | Path, now: str | Path, *, suite: str | None = None) -> BankChange:
    """Compare two banks: what they hold for, and what happened from their starts, by scene.

    Args:
        then: the earlier one; as for `show_baseline`.
        now: the later one.
        suite: as for `show_baseline`.

    Raises:
        UsageError, StoreError, IncomparableError: as `show_baseline`.
    """
    from nw_eval.results.bank_changes import bank_change

    banks = [show_baseline(each, suite=suite).bank for each in (then, now)]
    return bank_change(*banks)


def _listed(file: Path) -> ListedBaseline:
    from nw_eval.results.bank_changes import bank_mean
    from nw_eval.results.bank_file import read_bank

    suite, name = file.parent.name, file.stem
    try:
        bank = read_bank(file)
    except NwEvalError as error:
        return ListedBaseline(file=file, suite=suite, name=name, problem=str(error))
    return ListedBaseline(file=file, suite=suite, name=name, bank=bank, mean=bank_mean(bank))
