"""Finds the change of a card under which its policy follows its commands best.

A policy under its own card walks nearly level, and does what it is commanded; with the joints in
another order it stumbles within a second. So the change that brings it nearest to its commands is
most likely the mistake. How near that is depends on the policy: some turn at 0.7 of what they are
told under their own cards.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from nw_eval.cards import Card
from nw_eval.errors import NwEvalError
from nw_eval.onboarding.probe.following import Followed, Motion, deviation, follow
from nw_eval.onboarding.probe.recording import STUMBLES
from nw_eval.onboarding.probe.rig import Rig
from nw_eval.onboarding.variants.hypotheses import (
    Hypothesis,
    double_hypotheses,
    hypotheses,
    scale_hypotheses,
)
from nw_eval.robots import RobotSpec

_CLEARLY = 0.1  # Fall of the deviation from which on another card is told.
_SLIGHTLY = 0.03  # Fall from which on a card counts for more than a likelier one.
_ENOUGH = 0.1  # Deviation below which no card is clearly better. Of right cards: 0.07 to 0.23.
_LOST = 0.9  # Deviation of a policy that stumbles, stands, or does something else.


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """Another card, and what became of the commands under it."""

    hypothesis: Hypothesis
    written: Sequence[Followed]
    """What becomes of them under the card as it is written."""
    followed: Sequence[Followed]
    """The same commands, in the same order."""

    @property
    def helps(self) -> bool:
        """Whether the policy does clearly better, or no longer misses what it missed."""
        gain = deviation(self.written) - deviation(self.followed)
        no_longer = _does_all(self.followed) and not _does_all(self.written)
        return gain >= (_SLIGHTLY if no_longer else _CLEARLY)

    @property
    def mends(self) -> bool:
        """Whether it helps, and the policy then does all that one does under its own card."""
        return self.helps and _does_all(self.followed)

    @property
    def figures(self) -> str:
        """The share of each command that is reached, and was."""
        return ", ".join(
            f"{now.motion.words} {_share(now)} (was {_share(was)})"
            for now, was in zip(self.followed, self.written, strict=True)
        )


def attempts(
    rig: Rig,
    card: Card,
    robot: RobotSpec,
    written: Sequence[Followed],
    *,
    thorough: bool,
) -> Iterator[Attempt]:
    """Yield other cards, each better than those before; none if none is better than the card.

    Args:
        rig: of the policy.
        card: that is looked at.
        robot: that the policy drives.
        written: what becomes of commands under the card; at least one.
        thorough: whether everything is tried, or only other scales of the action.
    """
    order = sorted(range(len(written)), key=lambda place: _weight(written[place]))
    tried = [written[place].motion for place in order]
    limit, best = deviation(written) - _SLIGHTLY, None
    for changes in (hypotheses, double_hypotheses) if thorough else (scale_hypotheses,):
        for hypothesis in changes(card, robot):
            try:
                followed = _below(limit, rig, hypothesis.card, tried)
            except NwEvalError:
                continue  # Not even that: the card has it right in this respect.
            if followed is not None:
                limit = deviation(followed) - _SLIGHTLY
                again = dict(zip(order, followed, strict=True))
                in_order = [again[place] for place in range(len(written))]
                best = Attempt(hypothesis=hypothesis, written=written, followed=in_order)
                yield best
                if deviation(followed) < _ENOUGH:
                    return
        if best is not None and best.mends:
            return


def _does_all(followed: Sequence[Followed]) -> bool:
    return not any(one.is_missed or one.stumbled for one in followed)


def _share(one: Followed) -> str:
    ending = " and fell" if one.fell else " and stumbled" if one.stumbled else ""
    return f"{one.ratio:z.2f}{ending}"


def _weight(one: Followed) -> tuple[bool, bool, float]:
    """Return what comes first: what is missed, that trials command, and by most."""
    is_used = one.motion.is_used or one.motion.is_own
    return not (one.is_missed or one.stumbled), not is_used, -one.error


def _below(limit: float, rig: Rig, card: Card, tried: Sequence[Motion]) -> list[Followed] | None:
    """Return what becomes of commands if the deviation is below a limit.

    A card is given up as soon as it cannot be, and if the first of them is of no avail.
    """
    followed: list[Followed] = []
    for one in follow(rig, card, tried, level=STUMBLES):
        followed.append(one)
        hopeless = sum(past.error**2 for past in followed) >= max(limit, 0.0) ** 2 * len(tried)
        if hopeless or followed[0].error > _LOST:
            return None
    return followed
