"""What becomes of commands under a card, and whether another card does better."""

from __future__ import annotations

from nw_eval.policies import Card
from nw_eval.robots import RobotSpec
from nw_eval.rollout.probe.budget import Metered, SpentError
from nw_eval.rollout.probe.findings import Finding, command_findings
from nw_eval.rollout.probe.following import Followed, follow, motions, own_way
from nw_eval.rollout.probe.hypotheses import TRIED
from nw_eval.rollout.probe.recording import Recording
from nw_eval.rollout.probe.search import Attempt, attempts


def compare(
    stage: Metered, card: Card, robot: RobotSpec, recording: Recording
) -> tuple[list[Followed], list[Finding]]:
    """Return what becomes of commands under a card, and if another card does better.

    A card that mends everything is a fault even where trials command nothing of what is missed:
    one change with which a policy follows everything is what a wrong card looks like.

    Args:
        stage: of the policy; when its budget is used up, what was found until then is returned.
        card: that is looked at.
        robot: that the policy drives.
        recording: of the policy under its card. If it stumbles, commands tell what other cards
            improve, and no more; these are not tried on a policy that sees images, each of which
            would be rendered again.
    """
    stumbles = recording.stumbles
    if stumbles and recording.sees_images:
        return [], []
    tried = [*own_way(card), *motions(card)] if stumbles else motions(card)
    written: list[Followed] = []
    best: Attempt | None = None
    is_searched, is_bad = False, stumbles
    cut: list[Finding] = []
    try:
        for one in follow(stage, card, tried):
            written.append(one)
            is_bad = is_bad or one.is_missed
        is_weak = is_bad or any(one.is_weak for one in written)
        is_searched = bool(written) and is_weak and not recording.sees_images
        if is_searched:
            for attempt in attempts(stage, card, robot, written, thorough=is_bad):
                best = attempt
    except SpentError:
        text = f"cut off after {stage.spent:.0f} s of simulation: "
        if len(written) < len(tried):
            cut = [Finding(kind="fault", text=f"{text}not every command was tried")]
        else:
            cut = [Finding(kind="note", text=f"{text}not every other card was tried")]
    followed = [] if stumbles else written
    found = command_findings(followed)
    if best is not None and best.helps:
        found.append(_advice(best, card, stumbles=stumbles, is_bad=is_bad))
    elif is_searched and is_bad and not cut:
        nearest = "none comes nearer than the card as it is"
        if best is not None:
            nearest = f"the nearest, with {best.hypothesis.words}: {best.figures}"
        found.append(Finding(kind="note", text=f"nothing tried helps: {TRIED}; {nearest}"))
    return followed, [*found, *cut]


def _advice(best: Attempt, card: Card, *, stumbles: bool, is_bad: bool) -> Finding:
    is_fault = is_bad and best.mends
    does = ("walks" if stumbles else "follows") + ("" if is_fault else " better")
    text = f"it {does} {best.hypothesis.advice(card)}\n  then reached: {best.figures}"
    return Finding(kind="fault" if is_fault else "note", text=text)
