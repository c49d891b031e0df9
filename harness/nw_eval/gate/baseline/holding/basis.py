"""What a bank is to the trials of a run, and whether it has starts enough for that."""

from __future__ import annotations

import re
from hashlib import sha256

from nw_eval.errors import IncomparableError
from nw_eval.gate.baseline.comparison import TIMES, Basis, Checked, Claim
from nw_eval.gate.baseline.holding.match import renewing
from nw_eval.results.bank import Panel, SavedBank
from nw_eval.results.bank.manifest import machine_of
from nw_eval.results.provenance import PolicyInfo, RunInfo

_NOTHING = sha256(b"").hexdigest()


def basis_of(run: RunInfo, bank: SavedBank, checked: Checked | None) -> tuple[Basis, Panel]:
    """Return what the bank is to the run's trials, and the panel that speaks for the baseline.

    Args:
        run: on the bank's suite and simulator (`match.check_match`).
        bank: of the baseline.
        checked: what trials of the baseline have shown on this class of machine.

    Raises:
        IncomparableError: the bank has no panel of this class of machine, and nobody has checked.
    """
    panel = bank.panel_of(machine_of(run))
    if _is_baseline(run.policy, bank):
        return "same", panel or bank.panels[0]
    if panel is None and checked is None:
        raise IncomparableError(
            f"bank {bank.manifest.name} has no panel of this class of machine "
            f"({_unlike(run, bank)}), and no trial of the baseline has been run on it",
            fix=f"`nw-eval run --baseline {bank.manifest.name}` runs some first, or add a panel "
            f"with `{renewing(run, bank)}`",
        )
    if run.panel == "fresh":
        return "fresh", panel or bank.panels[0]
    is_sample = panel is None and checked == "scores"
    return "sample" if is_sample else "panel", panel or bank.panels[0]


def claim_of(run: RunInfo, bank: SavedBank, basis: Basis, budget: int) -> Claim:
    """Return of which starts a comparison may speak.

    Of the panel itself only if its order was drawn for this candidate: the first starts of a panel
    are as random as any among all starts, but not among those of the panel. Of fresh starts only if
    the panel has `TIMES` as many of them as there are rounds.

    Raises:
        IncomparableError: of none; saying how many starts to save.
    """
    if basis == "same":
        return "panel and fresh"
    has, enough = bank.manifest.starts, TIMES * budget
    is_drawn = basis == "panel" and run.drawn_from == has
    if has >= max(enough, run.drawn_from or 0):
        return "panel and fresh" if is_drawn else "fresh"
    if is_drawn and has >= max(budget, run.drawn_from or 0):
        return "panel"
    needs = max(budget if is_drawn else enough, run.drawn_from or 0)
    of = "" if is_drawn else f" ({TIMES} for each, to speak of fresh starts)"
    raise IncomparableError(
        f"bank {bank.manifest.name} has {has} starts in each scene; {budget} rounds need "
        f"{needs}{of}",
        fix=f"save them with `{renewing(run, bank, '--starts', str(needs))}`, or run fewer "
        "--trials",
    )


def _is_baseline(policy: PolicyInfo, bank: SavedBank) -> bool:
    """Return whether a policy is the baseline itself, as far as its digests can say."""
    theirs = bank.manifest.policy
    # An object in a process has whatever name its caller gives it; some servers give no digest.
    anonymous = policy.adapter == "remote" and policy.checkpoint_digest == _NOTHING
    verified = re.fullmatch("[0-9a-f]{64}", policy.checkpoint_digest) and not anonymous
    ours = (policy.checkpoint_digest, policy.card_digest)
    return bool(verified) and ours == (theirs.checkpoint_digest, theirs.card_digest)


def _unlike(run: RunInfo, bank: SavedBank) -> str:
    """Return in what this class of machine differs from the bank's nearest one."""
    ours = machine_of(run)
    differing = [
        [
            f"{name} {ours.get(name, 'none')}, the bank's {panel.machine.get(name, 'none')}"
            for name in sorted({*ours, *panel.machine})
            if ours.get(name) != panel.machine.get(name)
        ]
        for panel in bank.panels
    ]
    return ", ".join(min(differing, key=len))
