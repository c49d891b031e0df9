"""Runs a policy for some seconds, and returns what it showed and what is wrong with it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from time import monotonic
from typing import Any

from pydantic import TypeAdapter, ValidationError

from nw_eval.cards import Card, JointControl
from nw_eval.cards.joints import short_name
from nw_eval.catalogue import get_scene
from nw_eval.errors import PolicyError
from nw_eval.onboarding.probe.budget import Metered
from nw_eval.onboarding.probe.comparison import compare
from nw_eval.onboarding.probe.findings import (
    Range,
    action_findings,
    body_findings,
    input_findings,
    measure,
    observation_findings,
)
from nw_eval.onboarding.probe.following import Followed
from nw_eval.onboarding.probe.networks import network_findings, network_rows
from nw_eval.onboarding.probe.parts import parts_of
from nw_eval.onboarding.probe.recording import Recording
from nw_eval.onboarding.probe.rig import SceneRig
from nw_eval.onboarding.probe.rows import (
    FLAT,
    ProbedCommand,
    ProbedJoint,
    ProbedTerm,
    ProbeReport,
)
from nw_eval.policies import Bundle, load_bundle
from nw_eval.robots import RobotSpec, get_robot
from nw_eval.rollout.check_bundle import check_bundle
from nw_eval.rollout.confined.access import OPENING_SECONDS, policy_rules, running_rules
from nw_eval.rollout.confined.isolated import call_isolated
from nw_eval.rollout.fault import PolicyFailedError

SECONDS = 1.0
_TIME_LIMIT = 600.0  # s of wall time
_BUDGET = 360.0
"""Seconds of simulation for commands and other cards. Measured on six policies under 140 cards:
2 to 186, which took up to 13 s."""


def probe_policy(bundle: Bundle, *, scene: str = FLAT, allow_code: bool = False) -> ProbeReport:
    """Run a policy in a process of its own, and say what is odd.

    It runs for one second as its card says. In the flat room it is then commanded all ways, for
    two seconds each, and other cards are tried if it stumbles or misses a command.

    Raises:
        PolicyError, SceneError: it cannot be run at all, or fails as it runs.
    """
    sees = bool(bundle.card.splat_images)
    place = get_scene(scene)
    if sees and place.splat is not None:
        place.splat_store()  # The cache is out of that process's reach.
    answer = call_isolated(
        _probe,
        subject=bundle.where,
        rules=running_rules(bundle, scenes=[scene], allow_code=allow_code),
        time_limit=_TIME_LIMIT,
        renders=sees,
        policy_process=policy_rules(bundle),
        card=bundle.reference,
        checkpoint=None if bundle.checkpoint is None else str(bundle.checkpoint.resolve()),
        scene=scene,
        allow_code=allow_code,
    )
    try:
        return TypeAdapter(ProbeReport).validate_python(answer)
    except ValidationError:
        raise PolicyError(
            f"{bundle.card_path}: the check gave no answer that can be read",
            fix="do not use this checkpoint",
        ) from None


def _probe(*, card: str, checkpoint: str | None, scene: str, allow_code: bool) -> dict[str, Any]:
    bundle = load_bundle(card, checkpoint=None if checkpoint is None else Path(checkpoint))
    if not allow_code:  # As before a run, whose trials come after it.
        check_bundle(bundle, get_robot(bundle.card.robot), seconds=OPENING_SECONDS)
    return asdict(probe_here(bundle, scene=scene, allow_code=allow_code))


def probe_here(bundle: Bundle, *, scene: str = FLAT, allow_code: bool = False) -> ProbeReport:
    """As `probe_policy`, in this process: for checkpoints that one trusts.

    Raises:
        PolicyError, SceneError: it cannot be run at all, or fails as it runs.
    """
    # What begins in the first third of the time ends in time, even if a step takes 4 s.
    deadline = monotonic() + _TIME_LIMIT / 3.0
    card, robot = bundle.card, get_robot(bundle.card.robot)
    specs = check_bundle(bundle, robot, allow_code=allow_code)
    rig = SceneRig(bundle, scene=scene, allow_code=allow_code)
    try:
        recording = rig.record(card, seconds=SECONDS)
    except PolicyFailedError as error:
        raise PolicyError(f"{bundle.where}: {error}") from error
    ranges = [measure(part, recording) for part in parts_of(card, robot, specs)]
    followed: list[Followed] = []
    findings = [
        *observation_findings(ranges, recording),
        *input_findings(card, ranges, recording),
        *network_findings(card, recording),
        *action_findings(card, robot, recording),
        *body_findings(recording),
    ]
    if scene == FLAT:
        metered = Metered(rig, simulated=_BUDGET, deadline=deadline)
        followed, found = compare(metered, card, robot, recording)
        findings += found
    return ProbeReport(
        policy=bundle.name,
        scene=scene,
        seconds=recording.seconds,
        travelled=recording.travelled,
        terms=tuple(_term(value) for value in ranges),
        outputs=network_rows(card, recording),
        joints=_joints(card, robot, recording),
        drives_torque=card.control.action == "joint_torque",
        commands=tuple(_command(one) for one in followed),
        findings=tuple(findings),
    )


def _term(value: Range) -> ProbedTerm:
    part = value.part
    return ProbedTerm(
        observation=part.observation,
        term=part.kind,
        numbers=value.size,
        frames=part.steps,
        form=part.form,
        low=value.low,
        mean=value.mean,
        high=value.high,
        constant=value.constant,
    )


def _joints(card: Card, robot: RobotSpec, recording: Recording) -> tuple[ProbedJoint, ...]:
    """Return what was asked of each joint; none if the card does not fit the robot."""
    try:
        order = JointControl.from_card(card, robot).order
    except PolicyError:
        return ()
    others: list[ProbedJoint] = []
    for place, index in enumerate(order.tolist()):
        action, target = recording.actions[:, place], recording.targets[:, index]
        others.append(
            ProbedJoint(
                joint=short_name(robot.joints[index]),
                action_low=float(action.min()),
                action_mean=float(action.mean()),
                action_high=float(action.max()),
                target_low=float(target.min()),
                target_high=float(target.max()),
                torque=float(abs(recording.torques[:, index]).max()),
            )
        )
    return tuple(others)


def _command(followed: Followed) -> ProbedCommand:
    motion = followed.motion
    return ProbedCommand(
        command=motion.words,
        unit=motion.unit,
        commanded=motion.size,
        reached=followed.reached,
        share=followed.ratio,
        fell=followed.fell,
        stumbled=followed.stumbled,
    )
