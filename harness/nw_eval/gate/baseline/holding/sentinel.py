"""Whether the baseline does, on another class of machine, what its bank says of it.

On a class of machine that the bank has no panel of, kernels are others, and so are bits. A round of
the baseline's own trials shows whether they are. If they are not, nothing need be wrong: trials
part after some steps, and the bank is a sample of what the baseline does from these starts. So it
holds once the tests of the gate, in both directions, exclude that the baseline has fallen, or
risen, by max_drop. Where one of them convicts, or the rounds end first, the bank does not hold
here, and that is no fault of any candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nw_eval.gate.baseline.comparison import Checked
from nw_eval.gate.baseline.finding import margins_of
from nw_eval.gate.baseline.holding.match import renewing
from nw_eval.gate.baseline.rounds import Floats, Rounds, scores_of, whole_rounds
from nw_eval.plural import plural
from nw_eval.results.bank import Panel, SavedBank, Start, Stratum, trajectory
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row
from nw_eval.stats.bank import Bank, Ruling, decide, over_rounds
from nw_eval.suite.model import Gate
from nw_eval.words import Arm, Tier

_NAMED = 3  # scenes that a sentence names before it says "and more"
FROM_START = (
    *("success", "completed", "outcome", "end_reason"),
    *("waypoints_reached", "waypoints_total"),
)
"""Columns of a row that a baseline has of each start."""


@dataclass(frozen=True, kw_only=True)
class Sentinel:
    """What the baseline's trials so far show."""

    checked: Checked | None
    """In what they agree with the bank; None where that is open, or they do not."""
    moved: tuple[str, ...] = ()
    """In what they do not, in sentences."""
    open: tuple[str, ...] = ()
    """Why it is open, in sentences, for when no more rounds come."""


def watch(
    rows: Sequence[Row], run: RunInfo, bank: SavedBank, gate: Gate, *, arm: Arm = "baseline"
) -> Sentinel:
    """Compare the baseline's trials on this class of machine with the first panel of its bank.

    Args:
        rows: of the baseline, with results.
        run: theirs.
        bank: which has no panel of this class of machine.
        gate: margins, errors and tiers; scenes that are informational need only have equal bits.
        arm: whose rows they are: the candidate's, where it is the baseline's own policy.

    Raises:
        StoreError: a row is not of the baseline's run.
    """
    panel = bank.panels[0]
    strata = [stratum for stratum in panel.by_stratum if stratum[0] in run.scenes]
    rounds = whole_rounds(rows, run, strata, arm)
    if contradicted := _contradicted(rounds, panel):
        # The same states and actions are the same trial: its result is not a matter of bits.
        own = bank.manifest.policy.name
        first = f"the bank is not what its own policy {own} does: the same bits, other results"
        return Sentinel(checked=None, moved=(first, *contradicted[:_NAMED]))
    if rounds.count and _is_alike(rounds, panel):
        return Sentinel(checked="bits")
    judged = [stratum for stratum in strata if gate.tier(stratum[0]) != "informational"]
    scores, baseline = rounds.scores(judged), rounds.known(judged, panel)
    whole = np.array([scores_of(panel, stratum) for stratum in judged])
    fell = _ruling(scores, baseline, whole, gate)
    rose = _ruling(1.0 - scores, 1.0 - baseline, 1.0 - whole, gate)
    if fell.word == rose.word == "PASS":
        return Sentinel(checked="scores")
    means = _means(rounds, judged, scores, whole, bank)
    renew = f"nothing here is charged to the candidate; renew the bank with `{renewing(run, bank)}`"
    for ruling, verb in ((fell, "scores worse"), (rose, "scores better")):
        if ruling.word == "REGRESSED":
            named = [_change(judged[s], scores[:, s], whole[s]) for s in ruling.named]
            scenes = f", beyond doubt in {_listed(named)}" if named else ""
            return Sentinel(checked=None, moved=(f"{means}: it {verb} here{scenes}", renew))
    return Sentinel(checked=None, open=(f"{means}: whether it scores alike is open", renew))


def difference(row: Row, start: Start) -> str | None:
    """Return what of a trial is not as the baseline says, both values of each; None if nothing.

    Args:
        row: with a result.
        start: what the baseline says of it.
    """
    pairs = [(name, getattr(start, name), getattr(row, name)) for name in FROM_START]
    parts = [f"{name} {now}, the baseline's {then}" for name, then, now in pairs if then != now]
    if not parts and trajectory(row) != start.trajectory:
        parts = [f"bits {trajectory(row)}, the baseline's {start.trajectory}"]
    if not parts:
        return None
    cell = "".join(f" {axis} {value:g}" for axis, value in start.perturbation)
    # The first says most: the others follow from it.
    return f"scene {start.scene}{cell} start {start.seed_index}: {', '.join(parts[:_NAMED])}"


def _contradicted(rounds: Rounds, panel: Panel) -> tuple[str, ...]:
    """Return a sentence for each trial that went the bank's way, bit for bit, to another result."""
    pairs = (
        (row, panel.by_stratum[stratum][start])
        for stratum, rows in rounds.rows.items()
        for row, start in zip(rows, rounds.starts[stratum], strict=True)
    )
    same = ((row, at) for row, at in pairs if row is not None and trajectory(row) == at.trajectory)
    return tuple(text for row, at in same if (text := difference(row, at)) is not None)


def _is_alike(rounds: Rounds, panel: Panel) -> bool:
    """Whether every trial went the way that the bank has, bit for bit."""
    return all(
        row is not None and trajectory(row) == panel.by_stratum[stratum][start].trajectory
        for stratum, rows in rounds.rows.items()
        for row, start in zip(rows, rounds.starts[stratum], strict=True)
    )


def _ruling(scores: Floats, baseline: Floats, whole: Floats, gate: Gate) -> Ruling:
    """Return what the gate says of the drop from the bank; every scene convicts alone.

    Args:
        scores: shape (R, S).
        baseline: the bank's, of the same starts, shape (R, S).
        whole: the bank's, of all starts, shape (S, M).
        gate: margins and errors.
    """
    tiers: list[Tier] = ["critical"] * len(whole)
    return decide(
        over_rounds(Bank.of(whole), scores, baseline, margins_of(gate)),
        tiers,
        alpha_pass=1.0 - gate.confidence,
        alpha_regr=gate.false_alarm,
    )


def _means(
    rounds: Rounds, judged: Sequence[Stratum], scores: Floats, whole: Floats, bank: SavedBank
) -> str:
    if not rounds.count:
        return f"no round of the bank's policy {bank.manifest.policy.name} has run here"
    trials = plural(rounds.count * len(judged), "trial")
    return (
        f"the bank's own policy {bank.manifest.policy.name} goes other ways on this class of "
        f"machine: success {np.nanmean(scores):.3f} in {trials}, the bank's {whole.mean():.3f}"
    )


def _change(stratum: Stratum, scores: Floats, whole: Floats) -> str:
    name = " ".join([stratum[0], *(f"{axis} {value:g}" for axis, value in stratum[1])])
    return f"{name} ({np.nanmean(scores):.2f}, the bank's {whole.mean():.2f})"


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"
