"""The policy card: everything about a checkpoint that is not in the checkpoint.

A card says which robot the policy drives, what it sees, what its outputs mean, and which file
holds its weights. It contains no code.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from nw_policies.cards.control import CameraMounting, Control
from nw_policies.cards.model import CONTROL_RATE, CardModel, Line, is_whole
from nw_policies.cards.networks import (
    Adapter,
    Checkpoint,
    Inputs,
    Network,
    OutputKey,
    Recurrent,
    input_parts,
    is_built_in,
    recurrent_fault,
)
from nw_policies.cards.observations import (
    DirectionObservation,
    Observation,
    PluginObservation,
    ProprioObservation,
)
from nw_policies.cards.reference import Reference
from nw_policies.cards.terms import AnyTerm, AppliedAction, LastOutput, Moving
from nw_policies.cards.terms import Command as CommandTerm


class WaypointCommand(CardModel):
    """The policy finds its own way to the next waypoint (`delta_yaw`) at a speed."""

    source: Literal["waypoint"] = "waypoint"
    speed: float = Field(default=0.8, ge=0.0, le=5.0)
    """What the term `speed` reads, m/s."""


class TrailFollower(CardModel):
    """A velocity command that steers towards the next waypoint.

    vx = max(least_speed, speed * max(0, cos(delta_yaw))), vy = 0,
    yaw rate = clip(yaw_gain * delta_yaw).
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
    least_speed: float | None = Field(default=None, ge=0.0, le=5.0)
    """What vx is at least, m/s, for policies that turn only while they walk; None = 0."""

    @model_validator(mode="after")
    def _ordered(self) -> TrailFollower:
        if self.least_speed is not None and self.least_speed > self.speed:
            raise ValueError(
                f"least_speed, {self.least_speed:g} m/s, is more than speed, {self.speed:g} m/s"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_a_least_speed(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what is not given, so that cards without it keep their digest."""
        fields: dict[str, Any] = dump(self)
        if self.least_speed is None:
            fields.pop("least_speed", None)
        return fields


class ConstantCommand(CardModel):
    """The same velocity command at all times."""

    source: Literal["constant"]
    velocity: tuple[float, float, float]
    """vx, vy (m/s), yaw rate (rad/s)."""


Command = Annotated[
    WaypointCommand | TrailFollower | ConstantCommand, Field(discriminator="source")
]


SceneWords = Annotated[str, Field(min_length=1, max_length=1024)]

LEFT_OUT = "!"
"""What `trained_on` has before scenes that others of its words name, but the training left out."""

_HEARD = {"speed": "speed", "delta_yaw": "way"}
"""Terms by which a policy is told what to do, beside `command`."""


def _heard_by(terms: Sequence[AnyTerm]) -> set[str]:
    """Return by what terms tell a policy what to do."""
    heard = {_HEARD[term.term] for term in terms if term.term in _HEARD}
    commands = [term for term in terms if isinstance(term, CommandTerm)]
    if any(term.parts is None for term in commands):
        return heard | {"command"}
    parts = {part for term in commands for part in term.parts or ()}
    if len(parts) == len(("vx", "vy", "yaw")):
        return heard | {"command"}
    return heard | {"speed" if part == "vx" else part for part in parts}


SpeedName = Literal["lin_vel_x", "lin_vel_y", "ang_vel_z"]


_OF_JOINTS = {"joint_pos", "joint_vel", "last_output", "applied_action"}


def _without(term: Any, held: list[Any]) -> Any:
    """Return a term of joints without those that are held; another as it is."""
    words: dict[str, Any] = {"term": term} if isinstance(term, str) else term
    if words["term"] not in _OF_JOINTS or "leave_out" in words:
        return term
    return {**words, "leave_out": held}


def _plain_name(name: str) -> str:
    if not re.fullmatch(r"[a-z0-9][a-z0-9._-]{0,63}", name):
        message = f"{name[:70]!r} is not a valid policy name"
        raise ValueError(f"{message}; use at most 64 of a-z, 0-9, '.', '_' and '-'")
    return name


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
    trained_on: Annotated[tuple[SceneWords, ...], Field(max_length=1000)] = ()
    """The built-in scenes that it was trained in, as suites name them, such as `split:train`; with
    `!` before it, those of them that were left out. Reports mark them; no part of the digest."""
    trained_speeds: dict[SpeedName, tuple[float, float]] = Field(
        default_factory=dict[SpeedName, tuple[float, float]]
    )
    """The ranges of velocities that the training commanded: lin_vel_x, lin_vel_y (m/s), ang_vel_z
    (rad/s). `policies check` commands no others; no part of the digest."""
    robot: str
    """The name of the robot that the policy drives: go1, go2, or another."""
    adapter: Adapter
    """How the checkpoint is run; `zero` has none and answers every observation with zeros, `remote`
    has it on a server, `python:package.module:Class` is code and needs --allow-code."""
    checkpoint: Checkpoint | None = None
    """The file of weights; `zero` and `remote` have none, Python code may have one."""
    python: Annotated[str, Field(min_length=1, max_length=4096)] | None = None
    """For `python:` adapters, the interpreter that runs the code, such as `.venv/bin/python`: an
    environment of its own, which needs Python 3.11 or later and NumPy. A relative path starts from
    the card's folder; no part of the digest. None = this one."""
    runtime: Literal["native", "nw-eval"] | None = None
    """What runs the networks: `nw-eval`, whose results are the same on every processor; or
    `native`, ONNX Runtime or torch, whose results depend on the processor in their last digits.
    None = `nw-eval` where it has all of their operators, else `native`."""
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
    cameras: dict[str, CameraMounting] = Field(
        default_factory=dict[str, CameraMounting], max_length=16
    )
    """By name, cameras of the robot that are mounted otherwise than they are here."""
    inputs: Inputs | None = None
    """For each input of the checkpoint, the observations and networks that are joined to make it;
    or just their list, for a checkpoint with one input.

    None = the checkpoint has one input, made of all observations."""
    output: OutputKey | None = None
    """Which output of the checkpoint is the action: its name, or its position (from 0) among those
    that feed no recurrent state; None = its only or first one."""
    recurrent: Recurrent | None = None
    """Inputs of the checkpoint that an output of its last step feeds, and that output: `{h_in:
    h_out}`; of a TorchScript file `{h: {output: 1, shape: [1, 12]}}`. None = the pairs that the
    names of an ONNX graph show, and nothing of another file."""
    reference: Reference | None = None
    """The motion that the policy tracks; None = it tracks none. A card with an observation of a
    motion and without this leaves the motion to suites."""

    @model_validator(mode="before")
    @classmethod
    def _tracks_what_it_observes(cls, data: Any) -> Any:
        """Let a card that observes a motion leave it to suites, as with an empty `reference`."""
        try:
            seen = data["observations"].values()
            if data.get("reference") is None and any(o["sensor"] == "reference" for o in seen):
                return {**data, "reference": {}}
        except (KeyError, TypeError, AttributeError):
            pass  # What is wrong with it, its own model says.
        return data

    @model_validator(mode="before")
    @classmethod
    def _slow_observations(cls, data: Any) -> Any:
        """Let observations default to the policy's own rate, in place of 50 Hz."""
        try:
            rate = data["control"].get("rate", CONTROL_RATE)
            if rate == CONTROL_RATE or not isinstance(rate, int | float):
                return data
            slowed = {
                name: {"rate": rate, **observation}
                for name, observation in data["observations"].items()
            }
        except (KeyError, TypeError, AttributeError):
            return data  # What is wrong with it, its own model says.
        return {**data, "observations": slowed}

    @model_validator(mode="before")
    @classmethod
    def _nothing_of_the_held(cls, data: Any) -> Any:
        """Let terms of joints have no numbers of those that are held."""
        try:
            held = [*data["control"]["held"]]
            observations = {
                name: {**seen, "terms": [_without(term, held) for term in seen["terms"]]}
                if "terms" in seen
                else seen
                for name, seen in data["observations"].items()
            }
        except (KeyError, TypeError, AttributeError):
            return data  # What is wrong with it, its own model says.
        return {**data, "observations": observations}

    @model_validator(mode="after")
    def _consistent(self) -> Card:
        if self.adapter in {"zero", "remote"}:
            if self.checkpoint is not None:
                message = f"adapter `{self.adapter}` has no checkpoint; remove `checkpoint`"
                raise ValueError(message)
        elif self.checkpoint is None and not self.adapter.startswith("python:"):
            raise ValueError("`checkpoint` is missing; add `checkpoint: {file: ..., sha256: ...}`")
        if self.python is not None and not self.adapter.startswith("python:"):
            message = f"`python` runs code, and adapter `{self.adapter}` names none"
            raise ValueError(f"{message}; remove it, or write `adapter: python:module:Class`")
        if self.python is not None and self.networks:
            raise ValueError("`networks` feed no policy with a `python` of its own; remove one")
        is_elsewhere = self.adapter == "remote" or not is_built_in(self.adapter)
        if self.runtime == "nw-eval" and is_elsewhere:
            message = f"`runtime: nw-eval` runs networks in files, not adapter `{self.adapter}`"
            raise ValueError(f"{message}; remove it, or export the policy as ONNX")
        if self.adapter != "zero" and not self.observations:
            raise ValueError("`observations` is empty; name what the checkpoint sees")
        self._check_terms()
        self._check_rates()
        if (fault := recurrent_fault(self.adapter, self.recurrent)) is not None:
            raise ValueError("; ".join(fault))
        return self

    def _check_rates(self) -> None:
        control = self.control
        for name, observation in self.observations.items():
            if not is_whole(control.rate / observation.rate) or observation.rate > control.rate:
                raise ValueError(
                    f"{name!r} is sampled at {observation.rate} Hz, the policy acts at "
                    f"{control.rate} Hz; give a rate that divides it"
                )
            if not is_whole(observation.latency * control.step_rate):
                message = f"{name!r}: a latency of {observation.latency:g} s is not a whole number"
                step = 1 / control.step_rate
                raise ValueError(f"{message} of control steps; use a multiple of {step:g}")

    def _check_terms(self) -> None:
        """Refuse terms that need what the card does not say."""
        for name, observation in self.observations.items():
            if not isinstance(observation, ProprioObservation):
                continue
            terms = observation.frame_terms
            of_command = [t.term for t in terms if isinstance(t, CommandTerm | Moving)]
            if isinstance(self.command, WaypointCommand) and of_command:
                message = f"{name!r} has the term `{of_command[0]}` but the card commands no"
                message += " velocity"
                raise ValueError(f"{message}; add `command: {{source: trail_follower}}`")
            if self.control.clip is None and any(
                isinstance(term, LastOutput | AppliedAction) and term.clipped for term in terms
            ):
                message = f"{name!r} feeds a clipped action back but the card clips none"
                raise ValueError(f"{message}; add `clip` to `control`, or remove `clipped`")

    @property
    def needs_executor(self) -> bool:
        """Whether nw-eval runs networks of it: the policy's, or its motors'."""
        motors = self.control.motors or ()
        return self.is_planned or any(motor.kind == "network" for motor in motors)

    @property
    def is_planned(self) -> bool:
        """Whether nw-eval runs its networks, if it has all of their operators."""
        is_file = is_built_in(self.adapter) and self.adapter not in {"zero", "remote"}
        return is_file and self.runtime != "native"

    @property
    def adapters(self) -> frozenset[str]:
        """Of the checkpoint, and of the networks that feed it."""
        return frozenset({self.adapter, *(net.adapter for net in self.networks.values())})

    @property
    def meets_splat(self) -> bool:
        """Whether rays of an observation meet the scene's splat."""
        return any(getattr(seen, "source", None) == "splat" for seen in self.observations.values())

    @property
    def splat_images(self) -> list[str]:
        """Names of the observations that no scene without a splat can give."""
        return [name for name, seen in self.observations.items() if seen.needs_splat]

    @property
    def hears(self) -> frozenset[str]:
        """What tells the policy what to do: `command`, `speed`, the `way` to a waypoint, `motion`.

        Where it observes parts of a velocity command only, these are `speed`, `vy` and `yaw`.
        What a sensor of a package reads is its own affair: it may be any of them. A `zero` policy
        answers the same whatever it is told, so all can be told to it; a motion must be named.
        """
        heard: set[str] = {"command"} if self.adapter == "zero" else set()
        for seen in self.observations.values():
            if isinstance(seen, ProprioObservation):
                heard |= _heard_by(seen.frame_terms)
            elif isinstance(seen, DirectionObservation):
                heard.add("way")
            elif isinstance(seen, PluginObservation):
                heard |= {"command", "speed"}
        if self.reference is not None:
            heard.add("motion")
        return frozenset(heard)

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
        changed |= {"networks": {}, "options": {}, "output": None}
        # What feeds code, or a server, is opened beside it.
        runtime = self.runtime if self.is_planned else "native"
        return self.model_copy(update={**changed, "runtime": runtime})
