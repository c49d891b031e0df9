"""What becomes of commands under a card, and under which other card its policy follows them best.

A policy under its own card walks nearly level, and does what it is commanded; with the joints in
another order it stumbles within a second. So the change that brings it nearest to its commands is
most likely the mistake. How near that is depends on the policy: some turn at 0.7 of what they are
told under their own cards.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from nw_eval.cards import Card
from nw_eval.cards.command import ConstantCommand
from nw_eval.errors import NwEvalError
from nw_eval.onboarding.probe.findings import ProbeFinding, command_findings
from nw_eval.onboarding.probe.following import (
    Followed,
    Motion,
    deviation,
    finds_its_way,
    follow,
    motions,
    own_way,
    stands_still,
)
from nw_eval.onboarding.probe.hypotheses import (
    TRIED,
    Hypothesis,
    double_hypotheses,
    hypotheses,
    scale_hypotheses,
)
from nw_eval.onboarding.probe.recording import (
    STUMBLES,
    Metered,
    Recording,
    Rig,
    SpentError,
    Walk,
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


def compare(
    rig: Metered, card: Card, robot: RobotSpec, recording: Recording
) -> tuple[list[Followed], list[ProbeFinding]]:
    """Return what becomes of commands under a card, and if another card does better.

    Another card that mends everything makes the card as it is a fault where the policy stumbles,
    goes the opposite way, or does a trial better under the other card: waypoints with bends on
    level ground. All else is a note: a right card may turn at half of what it is told, and a change
    that helps there can cost success.

    Args:
        rig: of the policy; when its budget is used up, what was found until then is returned.
        card: that is looked at.
        robot: that the policy drives.
        recording: of the policy under its card. If it stumbles, commands tell what other cards
            improve, and no more; these are not tried on a policy that sees images, each of which
            would be rendered again.
    """
    tried = _tried(card, recording)
    written: list[Followed] = []
    try:
        for one in follow(rig, card, tried):
            written.append(one)  # noqa: PERF402 - what was before a cut is kept.
    except SpentError:
        return written, [*command_findings(written), _cut(rig, "fault", "every command")]
    found = [] if recording.stumbles else command_findings(written)
    if not recording.sees_images:
        trials = None if isinstance(card.command, ConstantCommand) else _Trials(rig, card)
        others = _others(rig, card, robot, written, trials, stumbles=recording.stumbles)
        if trials is not None and not any(one.kind == "fault" for one in others):
            found = _excused(found, written, trials)
        found += others
    return ([] if recording.stumbles else written), found


class _Trials:
    """Trials under the card as it is written, which runs once if at all, and under others."""

    def __init__(self, rig: Rig, card: Card) -> None:
        self._rig = rig
        self._card = card
        self._written: Walk | None = None

    @property
    def written(self) -> Walk:
        """How the trial ends under the card as it is written."""
        if self._written is None:
            self._written = _walk(self._rig, self._card)
        return self._written

    def are_better(self, card: Card) -> bool:
        """Whether the trial is completed under another card, and was not or took far longer."""
        return self.written.is_worse_than(_walk(self._rig, card))


def _walk(rig: Rig, card: Card) -> Walk:
    try:
        return rig.walk(card)
    except SpentError:
        raise
    except NwEvalError:
        return Walk(completed=False, seconds=0.0)


def _excused(
    found: list[ProbeFinding], written: Sequence[Followed], trials: _Trials
) -> list[ProbeFinding]:
    """Return what is missed as notes where the trial is completed and no command is reversed."""
    faulty = any(one.kind == "fault" for one in found)
    if not faulty or stands_still(written) or any(one.is_opposite for one in written):
        return found
    try:
        if not trials.written.completed:
            return found
    except SpentError:
        return found
    return [replace(one, kind="note") for one in found]


def _tried(card: Card, recording: Recording) -> list[Motion]:
    """Return what is commanded; a policy that sees no command is let go on its way."""
    commanded = motions(card)
    if recording.stumbles:
        return [] if recording.sees_images else [*own_way(card), *commanded]
    acts = bool((recording.actions != recording.actions[:1]).any())
    goes = acts and finds_its_way(card) and not recording.sees_images
    return own_way(card) if goes and not commanded else commanded


def _others(
    rig: Metered,
    card: Card,
    robot: RobotSpec,
    written: Sequence[Followed],
    trials: _Trials | None,
    *,
    stumbles: bool,
) -> list[ProbeFinding]:
    """Return the other card that helps most, or that none does."""
    is_bad = stumbles or any(one.is_missed or one.stumbled for one in written)
    if not written or not (is_bad or any(one.is_weak for one in written)):
        return []
    best: Attempt | None = None
    cut: list[ProbeFinding] = []
    try:
        for attempt in attempts(rig, card, robot, written, thorough=is_bad):
            best = attempt
    except SpentError:
        cut = [_cut(rig, "note", "every other card")]
    if best is not None and best.helps:
        is_certain = stumbles or any(one.is_opposite for one in written)
        matters = any(
            (one.is_missed or one.stumbled) and (one.motion.is_used or one.motion.is_own)
            for one in written
        )
        try:
            is_fault = best.mends and (is_certain or (matters and _better(trials, best)))
        except SpentError:
            is_fault = False
        does = ("walks" if stumbles else "follows") + ("" if is_fault else " better")
        text = f"it {does} {best.hypothesis.advice(card)}\n  then reached: {best.figures}"
        return [ProbeFinding(kind="fault" if is_fault else "note", text=text), *cut]
    if cut or not is_bad:
        return cut
    nearest = "none comes nearer than the card as it is"
    if best is not None:
        nearest = f"the nearest, with {best.hypothesis.words}: {best.figures}"
    return [ProbeFinding(kind="note", text=f"none of the changes tried helps: {TRIED}; {nearest}")]


def _better(trials: _Trials | None, best: Attempt) -> bool:
    """Whether trials are better under another card; so where the card drives along no course."""
    return trials is None or trials.are_better(best.hypothesis.card)


def _cut(rig: Metered, kind: Literal["fault", "note"], what: str) -> ProbeFinding:
    text = f"cut off after {rig.spent:.0f} s of simulation: not {what} was tried"
    return ProbeFinding(kind=kind, text=text)


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
