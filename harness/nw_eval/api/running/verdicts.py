"""The verdict on a run: by its suite's bar, and against the bank that it was begun with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from nw_eval.errors import IncomparableError
from nw_eval.gate.absolute import judge
from nw_eval.gate.baseline.combine import combined
from nw_eval.gate.baseline.judge import compare
from nw_eval.gate.baseline.known import known_rows

if TYPE_CHECKING:
    from nw_eval.gate.verdict import Verdict
    from nw_eval.results.bank import SavedBank
    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.suite import Suite


def verdict_on(folder: RunFolder, run: RunInfo, suite: Suite, rows: Sequence[Row]) -> Verdict:
    """Return the verdict on a run.

    INVALID is what was to be compared and cannot be, because the bank is gone, does not hold for
    the run, or not on its machine. What the bar says is told, and is no verdict.

    Args:
        folder: of the run.
        run: its run.json.
        suite: its suite.
        rows: that count.

    Raises:
        StoreError: rows contradict each other, or the run's copy of the bank is damaged.
    """
    from nw_eval.api.running.banks import kept_bank

    bar = judge(rows, suite.gate, run.planned)
    if run.baseline is None:
        return bar
    if run.baseline.moved:
        return _invalid(bar, run.baseline.moved)
    try:
        against = kept_bank(folder, run)
        assert against is not None, "the run has a baseline"
        checked = run.baseline.checked
        comparison = compare(rows, run, against.bank, suite.gate, checked=checked)
    except IncomparableError as error:
        return _invalid(bar, (str(error),))
    if comparison.basis == "same" and run.stopped_after == 0:
        known = _known(against.bank, run, suite)
        planned = Counter(row.scene for row in known)
        bar = judge(known, suite.gate, planned)
    return combined(bar, comparison)


def _invalid(bar: Verdict, why: Sequence[str]) -> Verdict:
    """Return a verdict that nothing can be said; what the bar says comes behind, if it says it."""
    also = (f"the bar alone: {bar.verdict}", *bar.reasons) if bar.n else ()
    return replace(bar, verdict="INVALID", reasons=(*why, *also))


def _known(bank: SavedBank, run: RunInfo, suite: Suite) -> tuple[Row, ...]:
    """Return what a bank's policy scored from all its starts in the scenes of a run."""
    from nw_eval.api.running.saved_run import saved_scenes
    from nw_eval.request import Request
    from nw_eval.results.bank.manifest import machine_of
    from nw_eval.suite import expand, override

    panel = bank.panel_of(machine_of(run)) or bank.panels[0]
    whole = override(suite, Request(trials=bank.manifest.starts))
    return known_rows(panel, run, expand(whole, saved_scenes(run)))
