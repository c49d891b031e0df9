"""What a bank is to the trials of a run, and whether it has starts enough for that."""

from __future__ import annotations

import re
from hashlib import sha256

from nw_eval.errors import IncomparableError
from nw_eval.gate.baseline.comparison import Basis, Claim
from nw_eval.gate.baseline.holding.match import renewing
from nw_eval.results.bank import Panel, SavedBank
from nw_eval.results.bank.manifest import machine_of
from nw_eval.results.provenance import PolicyInfo, RunInfo
from nw_eval.suite.model import Gate

_NOTHING = sha256(b"").hexdigest()


def basis_of(run: RunInfo, bank: SavedBank, checked: str | None) -> tuple[Basis, Panel]:
    """Return what the bank is to the run's trials, and the panel that speaks for the baseline.

    Args:
        run: on the bank's suite and simulator (`match.check_match`).
        bank: of the baseline.
        checked: what trials of the baseline have shown on this class of machine.

    Raises:
        IncomparableError: the bank has no panel of this class of machine, and nobody has checked.
    """
    panel = bank.panel_of(machine_of(run))
    if is_baseline(run.policy, bank):
        return "same", panel or bank.panels[0]
    if panel is None and checked not in {"bits", "control"}:
        raise IncomparableError(
            f"baseline {bank.manifest.name} has no panel of this class of machine "
            f"({_unlike(run, bank)}), and no trial of the baseline has been run on it",
            fix=f"`nw-eval run --baseline {bank.manifest.name}` runs some first, or add a panel "
            f"with `{renewing(run, bank)}`",
        )
    if panel is None and checked == "control":
        return "control", bank.panels[0]
    if run.panel == "fresh":
        return "fresh", panel or bank.panels[0]
    return "panel", panel or bank.panels[0]


def claim_of(run: RunInfo, bank: SavedBank, basis: Basis, rounds: int, gate: Gate) -> Claim:
    """Return of which starts a comparison speaks: of fresh ones, unless the suite says otherwise.

    Of the panel itself it may only where the order was drawn for this candidate from all of it: the
    first starts of a panel are as random as any among all starts, but not among those of the panel.

    Raises:
        IncomparableError: the bank has fewer starts than were drawn, or `gate.claim` is panel where
            none were.
    """
    has, is_drawn = bank.manifest.starts, basis == "panel" and run.drawn_from is not None
    needs = max(rounds if is_drawn else 0, run.drawn_from or 0)
    if basis != "same" and has < needs:
        raise IncomparableError(
            f"baseline {bank.manifest.name} has {has} starts in each scene; the run needs {needs}",
            fix=f"save them with `{renewing(run, bank, '--starts', str(needs))}`, or run fewer "
            "--trials",
        )
    if gate.claim == "fresh" or basis == "same":
        return "fresh"
    if is_drawn and run.drawn_from == has:
        return "panel"
    raise IncomparableError(
        f"gate.claim is panel, and the candidate did not meet starts that were drawn for it from "
        f"all {has} of baseline {bank.manifest.name} on a machine that it knows",
        fix="write `claim: fresh`",
    )


def is_baseline(policy: PolicyInfo, bank: SavedBank) -> bool:
    """Return whether a policy is the baseline itself, as far as its digests can say."""
    theirs = bank.manifest.policy
    # An object in a process has whatever name its caller gives it; some servers give no digest.
    anonymous = policy.adapter == "remote" and policy.checkpoint_digest == _NOTHING
    verified = re.fullmatch("[0-9a-f]{64}", policy.checkpoint_digest) and not anonymous
    ours = (policy.checkpoint_digest, policy.card_digest)
    return bool(verified) and ours == (theirs.checkpoint_digest, theirs.card_digest)


def _unlike(run: RunInfo, bank: SavedBank) -> str:
    """Return in what this class of machine differs from the baseline's nearest one."""
    ours = machine_of(run)
    differing = [
        [
            f"{name} {ours.get(name, 'none')}, the baseline's {panel.machine.get(name, 'none')}"
            for name in sorted({*ours, *panel.machine})
            if ours.get(name) != panel.machine.get(name)
        ]
        for panel in bank.panels
    ]
    return ", ".join(min(differing, key=len))
