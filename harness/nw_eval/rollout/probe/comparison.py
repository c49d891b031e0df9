"""What becomes of commands under a card, and whether another card does better."""

from __future__ import annotations

from nw_eval.policies import Card
from nw_eval.robots import RobotSpec
from nw_eval.rollout.probe.budget import Metered, SpentError
from nw_eval.rollout.probe.findings import Finding, command_findings
from nw_eval.rollout.probe.following import Followed, follow, motions
from nw_eval.rollout.probe.hypotheses import TRIED, Hypothesis
from nw_eval.rollout.probe.recording import Recording
from nw_eval.rollout.probe.search import better_cards


def compare(
    stage: Metered, card: Card, robot: RobotSpec, recording: Recording
) -> tuple[list[Followed], list[Finding]]:
    """Return what becomes of commands under a card, and if another card does better.

    A better card is a fault even where trials command nothing of what is missed: one change with
    which a policy follows everything is what a wrong card looks like.

    Args:
        stage: of the policy; when its budget is used up, what was found until then is returned.
        card: that is looked at.
        robot: that the policy drives.
        recording: of the policy under its card. If it stumbles, commands tell no more; other cards
            are not tried on a policy that sees images, each of which would be rendered again.
    """
    tried = [] if recording.stumbles else motions(card)
    followed: list[Followed] = []
    missed: list[Followed] = []
    better: Hypothesis | None = None
    is_searched = False
    cut: list[Finding] = []
    try:
        for one in follow(stage, card, tried):
            followed.append(one)
            missed += [one] if one.is_missed else []
        is_searched = (recording.stumbles or bool(missed)) and not recording.sees_images
        if is_searched:
            for hypothesis in better_cards(stage, card, robot, missed):
                better = hypothesis
    except SpentError:
        text = f"cut off after {stage.spent:.0f} s of simulation: "
        if len(followed) < len(tried):
            cut = [Finding(kind="fault", text=f"{text}not every command was tried")]
        else:
            cut = [Finding(kind="note", text=f"{text}not every other card was tried")]
    found = command_findings(followed)
    if better is not None:
        text = f"it {'follows' if missed else 'walks'} {better.advice(card)}"
        found.append(Finding(kind="fault", text=text))
    elif is_searched and not cut:
        found.append(Finding(kind="note", text=f"nothing tried helps: {TRIED}"))
    return followed, [*found, *cut]
