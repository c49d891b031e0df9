"""Finds the one change of a card that makes its policy walk, and follow its commands.

A policy under its own card walks nearly level, and does what it is commanded; with the joints in
another order it stumbles within a second. So the one change that mends it is most likely the
mistake; if several do, the one with which the policy follows its commands best.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from nw_eval.errors import NwEvalError
from nw_eval.policies import Card
from nw_eval.robots import RobotSpec
from nw_eval.rollout.probe.following import Followed, Motion, deviation, follow, motions
from nw_eval.rollout.probe.hypotheses import Hypothesis, hypotheses
from nw_eval.rollout.probe.recording import Recorder

_LEVEL = 0.2  # rad; what walks leans less
_FAR = 0.3  # m; what walks gets farther than that
_SECONDS = 2.0  # Some wrong cards take longer than one to fall.
_FITS = (0.75, 1.3)  # Shares of each command between which a better card brings the policy.


def better_cards(
    stage: Recorder, card: Card, robot: RobotSpec, missed: Sequence[Followed]
) -> Iterator[Hypothesis]:
    """Yield changes of a card that mend it, each better than those before; none if none does.

    Args:
        stage: of the policy.
        card: with which it stumbles, or misses commands.
        robot: that the policy drives.
        missed: commands that it does not follow; empty if it stumbles.
    """
    first = [one.motion for one in missed]
    order = [*first, *(motion for motion in motions(card) if motion not in first)]
    mends = _following if missed else _walking
    best: float | None = None
    for hypothesis in hypotheses(card, robot):
        try:
            score = mends(stage, hypothesis.card, order)
        except NwEvalError:
            continue  # Not even that: the card has it right in this respect.
        if score is not None and (best is None or score < best):
            best = score
            yield hypothesis


def _walking(stage: Recorder, card: Card, tried: Sequence[Motion]) -> float | None:
    """Return how badly a policy walks that does walk: by its commands, or else how it leans."""
    made = stage.record(card, seconds=_SECONDS, level=_LEVEL)
    tilt = float(made.tilt.max())
    if made.outcome is not None or tilt >= _LEVEL:
        return None
    if tried:
        return _following(stage, card, tried)
    return tilt if made.travelled > _FAR else None


def _following(stage: Recorder, card: Card, tried: Sequence[Motion]) -> float | None:
    """Return how far a policy is from its worst command, if it follows all of them."""
    followed: list[Followed] = []
    for one in follow(stage, card, tried):
        if one.fell or not _FITS[0] <= one.ratio <= _FITS[1]:
            return None
        followed.append(one)
    return deviation(followed)
