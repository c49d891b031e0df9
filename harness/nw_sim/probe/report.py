"""Runs a policy for some seconds, and returns what it showed and what is wrong with it.

The report is of plain values: they travel from a confined process.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from nw_base.errors import PolicyError
from nw_policies import Bundle, load_bundle
from nw_policies.cards import Card, JointControl
from nw_policies.cards.joints import short_name
from nw_scenes.robots import RobotSpec, find_robot, get_robot, know_robot
from nw_sim.catalogue import get_scene
from nw_sim.probe.findings import (
    ProbeFinding,
    Range,
    action_findings,
    body_findings,
    card_findings,
    compare,
    input_findings,
    measure,
    network_findings,
    network_outputs,
    observation_findings,
)
from nw_sim.probe.following import Followed
from nw_sim.probe.recording import Metered, Recording, SceneRig
from nw_sim.probe.runtimes import (
    ProbedRuntimes,
    compare_runtimes,
    is_computed,
    runtime_findings,
)
from nw_sim.probe.summary import parts_of
from nw_sim.rollout.confined.access import OPENING_SECONDS, policy_rules, running_rules
from nw_sim.rollout.confined.isolated import call_isolated
from nw_sim.rollout.confined.vetting import check_bundle
from nw_sim.rollout.fault import PolicyFailedError
from nw_sim.rollout.job import kernels_of

SECONDS = 1.0
_TIME_LIMIT = 600.0  # s of wall time
_BUDGET = 360.0
"""Seconds of simulation for commands and other cards. Measured on six policies under 140 cards:
2 to 186, which took up to 13 s."""
FLAT = "flat/carpet_room"
"""The room in which commands and other cards are tried, too."""
BEYOND = (
    "this check cannot detect settings that differ from training if the policy still walks: robot, "
    "pose, scale, frame, gain, torque limit, rate or delay"
)
"""What no second on the flat can show; added where no fault is found."""


@dataclass(frozen=True, kw_only=True)
class ProbedTerm:
    """The numbers of one term of an observation, or of a whole one without terms."""

    observation: str
    term: str
    numbers: int
    frames: int
    """Of a history, that they fill; 1 without one."""
    form: str
    """Scale, offset and limits as the card has them; empty where nothing is changed."""
    low: float
    mean: float
    high: float
    constant: int
    """How many of the numbers never changed."""


@dataclass(frozen=True, kw_only=True)
class ProbedOutput:
    """The numbers that a network gave which feeds the policy."""

    network: str
    output: str
    numbers: int
    rate: float
    """Hz at which the network is asked."""
    low: float
    mean: float
    high: float
    constant: int


@dataclass(frozen=True, kw_only=True)
class ProbedJoint:
    """What the policy asked of a joint. Targets in rad, or in N m for torques; torque in N m."""

    joint: str
    action_low: float
    action_mean: float
    action_high: float
    target_low: float
    target_high: float
    torque: float
    """The greatest, whichever its sign."""


@dataclass(frozen=True, kw_only=True)
class ProbedCommand:
    """What became of a command. Speeds in `unit`."""

    command: str
    unit: str
    """m/s or rad/s."""
    commanded: float
    reached: float
    share: float
    """Reached over commanded."""
    fell: bool
    stumbled: bool


@dataclass(frozen=True, kw_only=True)
class ProbeReport:
    """What some seconds of a policy showed, and what is wrong with it."""

    policy: str
    scene: str
    seconds: float
    travelled: float
    """Metres."""
    terms: tuple[ProbedTerm, ...]
    outputs: tuple[ProbedOutput, ...]
    joints: tuple[ProbedJoint, ...]
    """In the policy's order."""
    drives_torque: bool
    """Whether targets are torques."""
    commands: tuple[ProbedCommand, ...]
    findings: tuple[ProbeFinding, ...]
    runtimes: ProbedRuntimes | None = None
    """None where no file is computed that nw-eval could run."""

    @property
    def faults(self) -> int:
        """How many of the findings are faults."""
        return sum(finding.kind == "fault" for finding in self.findings)

    @property
    def passed(self) -> bool:
        """Whether no fault was found."""
        return not self.faults

    @property
    def caveat(self) -> str:
        """What the check could not show; empty where a fault was found, or off the flat."""
        return BEYOND if self.passed and self.scene == FLAT else ""


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
    robot = find_robot(bundle.card.robot)
    folders = () if robot.folder is None else (robot.folder,)
    answer = call_isolated(
        _probe,
        subject=bundle.where,
        rules=replace(
            running_rules(bundle, scenes=[scene], allow_code=allow_code, also=folders),
            kernels=("networks", "rays")
            if is_computed(bundle) or bundle.card.needs_executor
            else ("rays",),
        ),
        time_limit=_TIME_LIMIT,
        renders=kernels_of(robot.reference, bundle.card, "ewa") if sees else (),
        policy_process=policy_rules(bundle),
        card=bundle.reference,
        checkpoint=None if bundle.checkpoint is None else str(bundle.checkpoint.resolve()),
        robot=robot.reference,
        robot_folder=None if robot.folder is None else str(robot.folder),
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


def _probe(
    *,
    card: str,
    checkpoint: str | None,
    robot: str,
    robot_folder: str | None,
    scene: str,
    allow_code: bool,
) -> dict[str, Any]:
    know_robot(robot, None if robot_folder is None else Path(robot_folder))
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
        *card_findings(card),
        *observation_findings(ranges, recording),
        *input_findings(card, ranges, recording),
        *network_findings(card, recording, ranges),
        *action_findings(card, robot, recording, ranges),
        *body_findings(recording),
    ]
    if scene == FLAT:
        metered = Metered(rig, simulated=_BUDGET, deadline=deadline)
        followed, command_findings = compare(metered, card, robot, recording)
        findings += command_findings
    runtimes = compare_runtimes(bundle, recording) if is_computed(bundle) else None
    findings += runtime_findings(bundle, runtimes)
    return ProbeReport(
        policy=bundle.name,
        scene=scene,
        seconds=recording.seconds,
        travelled=recording.travelled,
        terms=tuple(_term(value) for value in ranges),
        outputs=_networks(card, recording),
        joints=_joints(card, robot, recording),
        drives_torque=card.control.has_torques,
        commands=tuple(_command(one) for one in followed),
        findings=tuple(findings),
        runtimes=runtimes,
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


def _networks(card: Card, recording: Recording) -> tuple[ProbedOutput, ...]:
    """Return what each output of each network gave."""
    outputs: list[ProbedOutput] = []
    for name, output in network_outputs(card):
        values = recording.fed[output].reshape(len(recording.actions), -1).astype(np.float64)
        outputs.append(
            ProbedOutput(
                network=name,
                output=output,
                numbers=values.shape[1],
                rate=card.networks[name].rate or card.control.rate,
                low=float(values.min()),
                mean=float(values.mean()),
                high=float(values.max()),
                constant=int((values == values[:1]).all(axis=0).sum()),
            )
        )
    return tuple(outputs)


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
