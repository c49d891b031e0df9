"""What becomes of commands under a card, and whether another card does better."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from nw_eval.cards import Card
from nw_eval.onboarding.probe.budget import Metered, SpentError
from nw_eval.onboarding.probe.findings import Finding, command_findings
from nw_eval.onboarding.probe.following import (
    Followed,
    Motion,
    finds_its_way,
    follow,
    motions,
    own_way,
)
from nw_eval.onboarding.probe.recording import Recording
from nw_eval.onboarding.probe.search import Attempt, attempts
from nw_eval.onboarding.variants.hypotheses import TRIED
from nw_eval.robots import RobotSpec


def compare(
    rig: Metered, card: Card, robot: RobotSpec, recording: Recording
) -> tuple[list[Followed], list[Finding]]:
    """Return what becomes of commands under a card, and if another card does better.

    A card that mends everything is a fault even where trials command nothing of what is missed:
    one change with which a policy follows everything is what a wrong card looks like.

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
        found += _others(rig, card, robot, written, stumbles=recording.stumbles)
    return ([] if recording.stumbles else written), found


def _tried(card: Card, recording: Recording) -> list[Motion]:
    """Return what is commanded; a policy that sees no command is let go on its way."""
    commanded = motions(card)
    if recording.stumbles:
        return [] if recording.sees_images else [*own_way(card), *commanded]
    acts = bool((recording.actions != recording.actions[:1]).any())
    goes = acts and finds_its_way(card) and not recording.sees_images
    return own_way(card) if goes and not commanded else commanded


def _others(
    rig: Metered, card: Card, robot: RobotSpec, written: Sequence[Followed], *, stumbles: bool
) -> list[Finding]:
    """Return the other card that helps most, or that none does."""
    is_bad = stumbles or any(one.is_missed or one.stumbled for one in written)
    if not written or not (is_bad or any(one.is_weak for one in written)):
        return []
    best: Attempt | None = None
    cut: list[Finding] = []
    try:
        for attempt in attempts(rig, card, robot, written, thorough=is_bad):
            best = attempt
    except SpentError:
        cut = [_cut(rig, "note", "every other card")]
    if best is not None and best.helps:
        is_fault = is_bad and best.mends
        does = ("walks" if stumbles else "follows") + ("" if is_fault else " better")
        text = f"it {does} {best.hypothesis.advice(card)}\n  then reached: {best.figures}"
        return [Finding(kind="fault" if is_fault else "note", text=text), *cut]
    if cut or not is_bad:
        return cut
    nearest = "none comes nearer than the card as it is"
    if best is not None:
        nearest = f"the nearest, with {best.hypothesis.words}: {best.figures}"
    return [Finding(kind="note", text=f"nothing tried helps: {TRIED}; {nearest}")]


def _cut(rig: Metered, kind: Literal["fault", "note"], what: str) -> Finding:
    text = f"cut off after {rig.spent:.0f} s of simulation: not {what} was tried"
    return Finding(kind=kind, text=text)
