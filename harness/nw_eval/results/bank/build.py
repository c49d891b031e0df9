"""From a run to a bank, and from two banks of one key to one with the panels of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from nw_eval.clean import clean
from nw_eval.errors import IncomparableError, TrialError
from nw_eval.plural import plural
from nw_eval.results.bank.check import SHARED, fault_of, place_of
from nw_eval.results.bank.manifest import BankPolicy, Manifest, PanelInfo, key_of, machine_of
from nw_eval.results.bank.start import Panel, SavedBank, Start, trajectory
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row, rows_digest


def bank_of_run(
    rows: Sequence[Row], run: RunInfo, *, name: str, card: str = "", by: str = "", note: str = ""
) -> SavedBank:
    """Return the bank that a finished run is: every start of its panel has a result.

    Args:
        rows: those of the run's plan, in any order.
        run: what they are of.
        name: the bank's.
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
            fix="save one from a run on the pinned panel",
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
        panels=(
            PanelInfo(
                machine=machine,
                saved=run.finished or run.started,
                by=clean(by, at_most=100),
                rows_digest=rows_digest(rows),
            ),
        ),
    )
    bank = SavedBank(manifest=manifest, panels=(Panel(machine=machine, starts=tuple(starts)),))
    if fault := fault_of(bank):
        raise IncomparableError(
            f"run {run.id} makes no baseline: {fault}",
            fix="save one from a run without a baseline, of all of the suite's scenes",
        )
    return bank


def with_panel(bank: SavedBank, other: SavedBank) -> SavedBank:
    """Return a bank with the panels of another one, of the same key, policy and starts, behind it.

    Args:
        bank: the bank.
        other: of other classes of machine.
    """
    infos = (*bank.manifest.panels, *other.manifest.panels)
    return replace(
        bank,
        manifest=bank.manifest.model_copy(update={"panels": infos}),
        panels=(*bank.panels, *other.panels),
    )


def _start(row: Row) -> Start:
    return Start(**{name: getattr(row, name) for name in SHARED}, trajectory=trajectory(row))
