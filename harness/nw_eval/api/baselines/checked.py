"""Whether a bank still holds here: each field that must match, then and now."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval.errors import IncomparableError, PolicyError

if TYPE_CHECKING:
    from nw_eval.api.baselines.here import Here
    from nw_eval.results.bank import SavedBank
    from nw_eval.results.bank_changes import FieldChange


@dataclass(frozen=True, kw_only=True)
class CheckedBaseline:
    """A bank against what it would be here and now."""

    file: Path
    bank: SavedBank
    changes: tuple[FieldChange, ...]
    """What must match and does not; none of it, and the bank holds."""
    has_panel: bool
    """Whether it has this class of machine."""
    machine: tuple[FieldChange, ...]
    """In what the bank's first class of machine is another one; empty with a panel of this one."""
    unchecked: str | None = None
    """Why its policy was not looked at, where it is not here."""
    suite: str
    """The suite as it was asked for, or by its name."""
    policy: str
    """The bank's policy as it was asked for, or as the bank knows where it lies."""

    @property
    def exit_code(self) -> int:
        """0 if the bank holds, 5 if it does not."""
        return IncomparableError.exit_code if self.changes else 0


def check_baseline(
    baseline: str | Path,
    *,
    suite: str | Path | None = None,
    policy: str | None = None,
    **changes: Any,
) -> CheckedBaseline:
    """Compare what a bank holds for with what is here: suite, scenes, simulator, policy.

    Args:
        baseline: its name, `<suite>/<name>`, or its path.
        suite: the suite's file; the suite of the bank's own by name if None.
        policy: where the bank's policy lies; where the bank says if None.
        changes: of `Request`: checkpoint, render, allow_code.

    Raises:
        UsageError: there is no such bank or suite.
        SuiteError: the suite cannot be used.
        StoreError: the bank is damaged.
        IncomparableError: it is no bank that anything can be compared with.
    """
    from nw_eval.api.baselines.here import here
    from nw_eval.api.baselines.listed import show_baseline
    from nw_eval.results.bank_changes import key_changes, machine_changes, policy_changes
    from nw_eval.suite import load_suite

    named = None if suite is None else load_suite(suite).name
    shown = show_baseline(baseline, suite=named)
    bank, wanted = shown.bank, str(suite or shown.bank.manifest.suite)
    own, unchecked = bank.manifest.policy, None
    try:
        place: Here = here(wanted, policy=policy or own.card or own.name, **changes)
        moved = policy_changes(own, place.policy)
    except PolicyError as error:
        if policy is not None:
            raise
        place, moved, unchecked = here(wanted, policy=None, **changes), (), error.message
    has_panel = bank.panel_of(place.machine) is not None
    return CheckedBaseline(
        file=shown.file,
        bank=bank,
        changes=(*key_changes(bank.manifest.key, place.key), *moved),
        has_panel=has_panel,
        machine=() if has_panel else machine_changes(bank.panels[0].machine, place.machine),
        unchecked=unchecked,
        suite=wanted,
        policy=policy or own.typed,
    )
