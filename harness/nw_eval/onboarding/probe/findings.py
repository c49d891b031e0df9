"""What is wrong with a recording, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nw_eval.built_in.entries import parted
from nw_eval.cards import Card, motors_follow
from nw_eval.cards.card import LEFT_OUT
from nw_eval.cards.inputs import resolve_inputs
from nw_eval.cards.joints import short_name
from nw_eval.cards.networks import input_parts
from nw_eval.cards.observations import ProprioObservation, SplatRgbObservation
from nw_eval.catalogue import is_meant
from nw_eval.catalogue import names as scene_names
from nw_eval.errors import nearest
from nw_eval.onboarding.probe.following import Followed, stands_still
from nw_eval.onboarding.probe.parts import Part
from nw_eval.onboarding.probe.recording import STUMBLES, Recording
from nw_eval.plural import plural
from nw_eval.robots import RobotSpec

Array = NDArray[np.float64]

_OFTEN = 0.2  # Share of control steps from which on a limit is a fault, not a moment.
_MOVES = 0.05  # rad; a target that moves less tells nothing of how its joint follows.
_LARGE = 30.0  # No scaled observation of a policy that learned is larger for long.
_MAY_REST = {
    "foot_contacts",
    "applied_action",
    "last_output",
    "speed",
    "command",
    "direction",
    "clock",
}


@dataclass(frozen=True, kw_only=True)
class ProbeFinding:
    """Something that a person should know."""

    kind: Literal["fault", "note"]
    text: str


@dataclass(frozen=True, kw_only=True)
class Range:
    """A part's numbers over the second."""

    part: Part
    low: float
    mean: float
    high: float
    constant: int
    """How many of its numbers never changed."""
    broken: int
    """How many values were NaN or infinite."""

    @property
    def size(self) -> int:
        """How many numbers the policy gets of it."""
        return len(self.part.indices)


def card_findings(card: Card) -> Iterator[ProbeFinding]:
    """Yield names in `trained_on` that are of no built-in scene: they mark no scene as trained in.

    Scenes of one's own (a path, `hub:`, `real:`) belong to no split, whether they are named or not.
    """
    for words in card.trained_on:
        pattern, _ = parted(words.removeprefix(LEFT_OUT))
        if pattern[:1] in ".~/" or (":" in pattern and not pattern.startswith("split:")):
            continue
        if not any(is_meant(name, pattern) for name in scene_names()):
            hint = nearest(pattern, scene_names())
            guess = f"; {hint}" if hint.startswith("did you mean") else ""
            text = f"`trained_on`: {words!r} names no built-in scene, and marks none as trained in"
            yield ProbeFinding(kind="note", text=f"{text}{guess}")


def measure(part: Part, recording: Recording) -> Range:
    """Return the range of a part; of what is finite."""
    whole = recording.observations[part.observation]
    values = whole.reshape(len(whole), -1)[:, part.indices].astype(np.float64)
    finite = values[np.isfinite(values)]
    if not finite.size:
        finite = np.full(1, np.nan)
    return Range(
        part=part,
        low=float(finite.min()),
        mean=float(finite.mean()),
        high=float(finite.max()),
        constant=int((values == values[:1]).all(axis=0).sum()),
        broken=int(values.size - np.isfinite(values).sum()),
    )


def observation_findings(ranges: list[Range], recording: Recording) -> list[ProbeFinding]:
    """Return what is odd about the observations."""
    findings: list[ProbeFinding] = []
    for value in ranges:
        part = value.part
        name = f"`{part.observation}`" + (f", {part.kind}" if part.kind else "")
        if value.broken:
            kind = "note" if part.kind == "lidar" else "fault"
            findings.append(
                ProbeFinding(kind=kind, text=f"{name}: {value.broken} of its values are NaN or inf")
            )
        if value.constant == value.size and not part.is_fixed:
            kind = "note" if part.kind in _MAY_REST else "fault"
            text = f"{name}: dead, it reads {value.mean:z.4g} from beginning to end"
            findings.append(ProbeFinding(kind=kind, text=text))
        largest = max(abs(value.low), abs(value.high))
        if part.limits is not None and _share_at(part, recording) > _OFTEN:
            low, high = part.limits
            text = f"{name}: its limits {low:g}..{high:g} clip it in most steps; check its scale"
            findings.append(ProbeFinding(kind="fault", text=text))
        elif largest > _LARGE and part.kind in _TERMS_OF_ORDER_ONE:
            text = f"{name}: reaches {largest:.3g}; a scale may be missing"
            findings.append(ProbeFinding(kind="note", text=text))
    return findings


def input_findings(card: Card, ranges: list[Range], recording: Recording) -> list[ProbeFinding]:
    """Return which inputs are not what a checkpoint is likely to have been trained on."""
    findings: list[ProbeFinding] = []
    files = [(card, recording.inputs)]
    files += [(card.of_network(name), specs) for name, specs in recording.fed_inputs.items()]
    for file, specs in files:
        for spec, names in resolve_inputs(file, specs) if specs else ():
            for name in (one for one in names if one in card.observations):
                is_rgb = isinstance(card.observations[name], SplatRgbObservation)
                is_bytes = recording.observations[name].dtype == np.uint8
                if is_rgb and is_bytes and spec.dtype.kind == "f":
                    text = f"`{name}` gives bytes 0..255 to a {spec.dtype} input; "
                    findings.append(
                        ProbeFinding(kind="note", text=f"{text}`dtype: float32` gives 0..1")
                    )
    zeros: dict[str, int] = {}
    for value in ranges:
        name, observation = value.part.observation, card.observations[value.part.observation]
        is_listed = isinstance(observation, ProprioObservation) and observation.terms is not None
        if is_listed and value.part.kind == "constant" and value.low == value.high == 0.0:
            zeros[name] = zeros.get(name, 0) + value.size
    rests = recording.travelled < _AT_REST * recording.seconds
    is_told = any(value.part.kind in _WHERE_TO for value in ranges)
    for name, count in zeros.items():
        text = (
            f"`{name}` holds {plural(count, 'zero')} instead of what the checkpoint was trained on"
        )
        if rests and not is_told:
            text += (
                ", and it does not go on: name the term that tells it where to, such as `command`"
            )
        kind = "fault" if rests and not is_told else "note"
        findings.append(ProbeFinding(kind=kind, text=text))
    return findings


_WHERE_TO = {"command", "delta_yaw", "speed"}
_AT_REST = 0.2
"""Metres a second below which a robot does not go on; courses are walked at 0.8."""
_TERMS_OF_ORDER_ONE = {"joint_pos", "joint_vel", "ang_vel", "lin_vel", "gravity", "last_output"}


def network_findings(card: Card, recording: Recording, ranges: list[Range]) -> list[ProbeFinding]:
    """Return which networks do not react to their inputs."""
    findings: list[ProbeFinding] = []
    for name, output in network_outputs(card):
        values = recording.fed[output]
        if len(values) > 1 and (values == values[:1]).all():
            parts = {part for _, own in input_parts(card.networks[name].inputs) for part in own}
            own = [value for value in ranges if value.part.observation in parts]
            # What other networks feed it is not looked at here.
            own = own if parts <= set(card.observations) else []
            text = f"network `{name}`: `{output}` is the same at every step: {_blame(own)}"
            findings.append(ProbeFinding(kind="fault", text=text))
    return findings


def network_outputs(card: Card) -> Iterator[tuple[str, str]]:
    """Yield every output of a network after the name of the network."""
    for name, network in card.networks.items():
        for output in network.given_as(name):
            yield name, output


def action_findings(
    card: Card, robot: RobotSpec, recording: Recording, fed: Sequence[Range] = ()
) -> list[ProbeFinding]:
    """Return what is odd about the actions and what the motors made of them.

    Args:
        card: under which it acts.
        robot: that it drives.
        recording: of it.
        fed: the parts of what it is fed; where it always acts alike they tell whose fault it is.
    """
    findings: list[ProbeFinding] = []
    actions = recording.actions
    if (actions == actions[:1]).all() and card.adapter != "zero":
        text = f"the action is the same at every step: {_blame(fed)}"
        findings.append(ProbeFinding(kind="fault", text=text))
    if card.control.clip is not None:
        low, high = card.control.clip
        cut = ((actions <= low) | (actions >= high)).mean(axis=0)
        order = card.control.joints or list(robot.joints)
        findings += _by_joint(
            cut, order, f"the action is at its limits {low:g}..{high:g} (`control.clip`)"
        )
    if not card.control.has_torques:
        ranges = np.array(robot.joint_ranges)
        turned = np.array(motors_follow(card, robot)) == "position"
        outside = (recording.targets < ranges[:, 0]) | (recording.targets > ranges[:, 1])
        outside &= turned
        findings += _by_joint(
            outside.mean(axis=0), robot.joints, "the target is beyond the joint's range", note=True
        )
        if recording.stumbles:
            findings += _against(robot, recording)
    strained = np.abs(recording.torques) >= 0.999 * recording.torque_limits
    findings += _by_joint(strained.mean(axis=0), robot.joints, "the motor is at its torque limit")
    return findings


def _blame(ranges: Sequence[Range]) -> str:
    """Say whether a network that gives the same at every step is fed anything that changes."""
    fed = sum(value.size for value in ranges)
    constant = sum(value.constant for value in ranges)
    if fed and constant == fed:
        return (
            f"all {plural(fed, 'number')} that the card feeds it are constant; name the terms that "
            "it was trained on under `observations`"
        )
    return "the checkpoint does not react to its inputs" + (
        f", of which {constant} of {fed} are constant" if constant else ""
    )


def body_findings(recording: Recording) -> list[ProbeFinding]:
    """Return how the robot fared."""
    if recording.outcome is not None:
        words = {"fell": "fell over", "collided": "hit its head or trunk"}
        text = f"it {words.get(recording.outcome, recording.outcome)} at {recording.seconds:.2f} s"
        return [ProbeFinding(kind="fault", text=text)]
    tilt = float(recording.tilt.max())
    if tilt > STUMBLES:
        return [ProbeFinding(kind="fault", text=f"it leans by {tilt:.2f} rad on the way")]
    return []


def command_findings(followed: list[Followed]) -> list[ProbeFinding]:
    """Return which commands are missed; a fault where trials command it."""
    missed = [one for one in followed if one.is_missed]
    if stands_still(followed):
        is_own = all(one.motion.is_own for one in followed)
        kind = "fault" if is_own or any(one.motion.is_used for one in missed) else "note"
        text = "it stands still" if is_own else "it stands still, whatever is commanded"
        return [ProbeFinding(kind=kind, text=f"`command`: {text}")]
    findings: list[ProbeFinding] = []
    for one in missed:
        direction, commanded, reached = one.words
        text = f"`command`: {commanded} {direction}, {reached} reached ({one.ratio:z.0%})"
        text += ", and it fell" if one.fell else ""
        scales = "" if one.motion.is_own else " and the `scale` of `command`"
        text += f"; check `control.scale`{scales}"
        findings.append(ProbeFinding(kind="fault" if one.motion.is_used else "note", text=text))
    return findings


def _against(robot: RobotSpec, recording: Recording) -> list[ProbeFinding]:
    """Find joints that move away from their targets.

    No card has negative gains, so the ground pushes them; that of walking policies does it too.
    """
    wanted = recording.targets - recording.positions[:-1]
    moved = np.diff(recording.positions, axis=0)
    findings: list[ProbeFinding] = []
    for index, joint in enumerate(robot.joints):
        pull, motion = wanted[:, index], moved[:, index]
        if np.ptp(recording.targets[:, index]) < _MOVES or motion.std() < 1e-4:
            continue
        agreement = float(np.corrcoef(pull, motion)[0, 1])
        if agreement < -_OFTEN:
            text = f"{short_name(joint)}: moves against its targets (correlation {agreement:.2f})"
            findings.append(ProbeFinding(kind="note", text=text))
    return findings


def _by_joint(shares: Array, joints: Any, what: str, *, note: bool = False) -> list[ProbeFinding]:
    often = [
        f"{short_name(joint)} {share:.0%}"
        for joint, share in zip(joints, shares.tolist(), strict=True)
        if share > _OFTEN
    ]
    if not often:
        return []
    kind = "note" if note else "fault"
    return [ProbeFinding(kind=kind, text=f"{what} in much of the second: {', '.join(often)}")]


def _share_at(part: Part, recording: Recording) -> float:
    if part.limits is None:
        return 0.0
    whole = recording.observations[part.observation]
    values = whole.reshape(len(whole), -1)[:, part.indices]
    low, high = part.limits
    return float(((values <= low) | (values >= high)).mean())
