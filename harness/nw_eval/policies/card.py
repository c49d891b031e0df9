"""The policy card: everything about a checkpoint that is not in the checkpoint.

A card says which robot the policy drives, what it sees, what its outputs mean, and which file
holds its weights. It contains no code.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from nw_eval.errors import nearest
from nw_eval.policies.action_filter import ButterworthFilter, LowPass
from nw_eval.policies.card_networks import Inputs, Network, OutputKey, input_parts
from nw_eval.policies.checkpoint import Checkpoint
from nw_eval.policies.joints import PerJoint
from nw_eval.policies.model import CONTROL_RATE, CardModel, Limits, Line
from nw_eval.policies.observations import Observation, ProprioObservation
from nw_eval.policies.terms import AppliedAction, LastOutput
from nw_eval.policies.terms import Command as CommandTerm

PHYSICS_RATE = 200
"""Physics steps per second of every protocol, unless a card says otherwise, Hz."""


def _control_rate(rate: int) -> int:
    if rate < 1 or CONTROL_RATE % rate:
        message = f"{rate} actions a second do not fit the {CONTROL_RATE} Hz of every trial"
        raise ValueError(f"{message}, in which waypoints, sensors and logs count; {_SLOWER}")
    return rate


_SLOWER = "use 50, 25, 10, 5, 2 or 1, or export a policy of one of these rates"

ControlRate = Annotated[int, AfterValidator(_control_rate)]


def _physics_rate(rate: int) -> int:
    if rate % CONTROL_RATE or not 2 * CONTROL_RATE <= rate <= 2000:
        message = f"{rate} physics steps a second are no multiple of {CONTROL_RATE} up to 2000"
        raise ValueError(f"{message}; use 200 (the default), 250, 500 or 1000")
    return rate


PhysicsRate = Annotated[int, AfterValidator(_physics_rate)]


def _plain_name(name: str) -> str:
    if not re.fullmatch(r"[a-z0-9][a-z0-9._-]{0,63}", name):
        message = f"{name[:70]!r} is no name for a policy"
        raise ValueError(f"{message}; use a-z, 0-9, '.', '_' and '-', at most 64 of them")
    return name


class Control(CardModel):
    """What a raw action means, and the motors that it drives."""

    rate: ControlRate = CONTROL_RATE
    """Actions per second, Hz. Below 50 each action is held for 50 / rate control steps."""
    physics_rate: PhysicsRate = PHYSICS_RATE
    """Physics steps per second, Hz: a multiple of 50."""
    action: Literal["joint_position_offset", "joint_position", "joint_torque"]
    """Joint target = default pose + scale * action, or scale * action; or torque = scale * action.
    """
    scale: PerJoint = 1.0
    """rad, or N m, for each unit of action."""
    clip: Limits | None = None
    """Limits of the raw action, before scaling."""
    delay_steps: int = Field(default=0, ge=0, le=10)
    """Actions that are applied before a new one is: its latency, in periods of `rate`."""
    filter: LowPass | None = None
    """Low-pass on the raw action, behind limits and latency and before scaling; null = none."""
    joints: list[str] | None = None
    """Names in the checkpoint's order, for actions and observations; None = the robot's order."""
    default_pose: PerJoint | None = None
    """rad; None = the robot's."""
    kp: PerJoint | None = None
    """Position gain, N m/rad; None = the robot's, here and below."""
    kd: PerJoint | None = None
    """Joint damping, N m s/rad; None = none where actions are torques."""
    torque_limits: PerJoint | None = None
    """N m."""
    armature: PerJoint | None = None
    """kg m^2."""
    friction_loss: PerJoint | None = None
    """N m."""

    @field_validator("kp")
    @classmethod
    def _only_for_positions(cls, kp: PerJoint | None, info: ValidationInfo) -> PerJoint | None:
        if kp is not None and info.data.get("action") == "joint_torque":
            raise ValueError("kp has no meaning for torques; remove it, or choose another `action`")
        return kp

    @field_validator("filter")
    @classmethod
    def _below_half_the_rate(cls, low_pass: LowPass | None, info: ValidationInfo) -> LowPass | None:
        rate = info.data.get("rate", CONTROL_RATE)
        if isinstance(low_pass, ButterworthFilter) and not low_pass.cutoff < rate / 2:
            message = f"a cutoff of {low_pass.cutoff:g} Hz is not below half of {rate} actions a"
            raise ValueError(f"{message} second; give less than {rate / 2:g}, or remove `filter`")
        return low_pass

    @property
    def hold(self) -> int:
        """Control steps of 0.02 s from one action to the next."""
        return CONTROL_RATE // self.rate


class WaypointCommand(CardModel):
    """The policy finds its own way to the next waypoint (`delta_yaw`) at a speed."""

    source: Literal["waypoint"] = "waypoint"
    speed: float = Field(default=0.8, ge=0.0, le=5.0)
    """What the term `speed` reads, m/s."""


class TrailFollower(CardModel):
    """A velocity command that steers towards the next waypoint.

    vx = speed * max(0, cos(delta_yaw)), vy = 0, yaw rate = clip(yaw_gain * delta_yaw).
    """

    source: Literal["trail_follower"]
    speed: float = Field(default=0.8, ge=0.0, le=5.0)
    """m/s."""
    yaw_gain: float = Field(default=1.5, ge=0.0)
    """Yaw rate for each radian off course, 1/s."""
    yaw_limit: float = Field(default=1.0, gt=0.0)
    """Largest yaw rate, rad/s."""
    slow_in_turns: bool = True
    """False: vx = speed always."""


class ConstantCommand(CardModel):
    """The same velocity command at all times."""

    source: Literal["constant"]
    velocity: tuple[float, float, float]
    """vx, vy (m/s), yaw rate (rad/s)."""


Command = Annotated[
    WaypointCommand | TrailFollower | ConstantCommand, Field(discriminator="source")
]


ADAPTERS = (
    "onnx",
    "torchscript",
    "torch-export",
    "lucidsim",
    "extreme-parkour",
    "act",
    "remote",
    "zero",
)


def _known_adapter(name: str) -> str:
    if name in ADAPTERS or re.fullmatch(r"python:[A-Za-z_][\w.]*:[A-Za-z_]\w*", name):
        return name
    if name.startswith("python:"):
        message = f"{name!r} names no class; write python:package.module:Class"
        raise ValueError(message)
    message = f"unknown adapter {name!r}; {nearest(name, ADAPTERS)}"
    raise ValueError(message)


class Card(CardModel):
    """A policy card, valid in itself. `sensors.check_card` checks it against a robot."""

    schema_version: Literal[1] = Field(alias="nw-policy")
    """Version of this kind of file."""
    name: Annotated[str, AfterValidator(_plain_name)]
    """What reports call the policy: a-z, 0-9, '.', '_' and '-'."""
    title: Line = ""
    """One line for people; no part of the digest, nor is `licence`."""
    licence: Line = ""
    """Terms under which others may use the checkpoint."""
    robot: str
    """The robot that the policy drives: go1 or go2."""
    adapter: Annotated[str, AfterValidator(_known_adapter)]
    """How the checkpoint is run; `zero` has none and answers every observation with zeros, `remote`
    has it on a server, `python:package.module:Class` is code and needs --allow-code."""
    checkpoint: Checkpoint | None = None
    """The file of weights; `zero` and `remote` have none, Python code may have one."""
    options: dict[str, Any] = Field(default_factory=dict[str, Any])
    """What only this adapter understands; each adapter says what that is."""
    control: Control
    """What an action means, and the motors that it drives."""
    command: Command = WaypointCommand()
    """What the policy is told to do."""
    observations: dict[str, Observation] = Field(default_factory=dict[str, Observation])
    """By name, in the order in which a checkpoint with one input takes them."""
    networks: dict[str, Network] = Field(default_factory=dict[str, Network], max_length=16)
    """By name, files of their own that feed the checkpoint, or each other. What they give is named
    in `inputs` as an observation is."""
    inputs: Inputs | None = None
    """For each input of the checkpoint, the observations and networks that are joined to make it;
    or just their list, for a checkpoint with one input.

    None = the checkpoint has one input, made of all observations."""
    output: OutputKey | None = None
    """Which output of the checkpoint is the action: its name, or its place (from 0) among those
    that feed no recurrent state; None = its only or first one."""
    recurrent: dict[str, str] | None = None
    """Inputs of the checkpoint that an output of its last step feeds, and that output: `{h_in:
    h_out}`. None = the pairs that its names show. Only `onnx` needs to be told."""

    @model_validator(mode="before")
    @classmethod
    def _slow_observations(cls, data: Any) -> Any:
        """Let a slow policy's observations default to its own rate, in place of 50 Hz."""
        try:
            rate = data["control"].get("rate", CONTROL_RATE)
            if rate == CONTROL_RATE or not isinstance(rate, int):
                return data
            slowed = {
                name: {"rate": rate, **observation}
                for name, observation in data["observations"].items()
            }
        except (KeyError, TypeError, AttributeError):
            return data  # What is wrong with it, its own model says.
        return {**data, "observations": slowed}

    @model_validator(mode="after")
    def _consistent(self) -> Card:
        if self.adapter in {"zero", "remote"}:
            if self.checkpoint is not None:
                message = f"adapter `{self.adapter}` has no checkpoint; remove `checkpoint`"
                raise ValueError(message)
        elif self.checkpoint is None and not self.adapter.startswith("python:"):
            raise ValueError("`checkpoint` is missing; add `checkpoint: {file: ..., sha256: ...}`")
        if self.adapter != "zero" and not self.observations:
            raise ValueError("`observations` is empty; name what the checkpoint sees")
        self._check_terms()
        self._check_rates()
        if self.recurrent and self.adapter != "onnx":
            message = f"`recurrent` is for adapter onnx; `{self.adapter}` keeps its state itself"
            raise ValueError(f"{message}; remove it")
        return self

    def _check_rates(self) -> None:
        for name, observation in self.observations.items():
            if self.control.rate % observation.rate:
                raise ValueError(
                    f"{name!r} is sampled at {observation.rate} Hz, the policy acts at "
                    f"{self.control.rate} Hz; give a rate that divides it"
                )

    def _check_terms(self) -> None:
        """Refuse terms that need what the card does not say."""
        for name, observation in self.observations.items():
            if not isinstance(observation, ProprioObservation):
                continue
            terms = observation.frame_terms
            if isinstance(self.command, WaypointCommand) and any(
                isinstance(term, CommandTerm) for term in terms
            ):
                message = f"{name!r} has the term `command` but the card commands no velocity"
                raise ValueError(f"{message}; add `command: {{source: trail_follower}}`")
            if self.control.clip is None and any(
                isinstance(term, LastOutput | AppliedAction) and term.clipped for term in terms
            ):
                message = f"{name!r} feeds a clipped action back but the card clips none"
                raise ValueError(f"{message}; add `clip` to `control`, or remove `clipped`")

    def input_parts(self) -> tuple[tuple[str | None, tuple[str, ...]], ...]:
        """Return input names with the observations and networks they are made of.

        The name is None where the card leaves it to the checkpoint, which has one input then.
        """
        return input_parts(list(self.observations) if self.inputs is None else self.inputs)

    def of_network(self, name: str) -> Card:
        """Return the card of one of the networks: of its file alone, as if that were the policy."""
        network = self.networks[name]
        alone = {"adapter", "checkpoint", "inputs", "recurrent"}
        changed = {key: getattr(network, key) for key in alone}
        return self.model_copy(update={**changed, "networks": {}, "options": {}, "output": None})
