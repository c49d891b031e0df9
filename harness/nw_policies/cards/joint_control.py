"""Settings of a card for its robot: joint targets of raw actions, motors, cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PolicyError, nearest
from nw_base.protocol import EvaluationProtocol
from nw_policies.cards.card import Card
from nw_policies.cards.control import PHYSICS_RATE
from nw_policies.cards.joints import (
    ActionKind,
    PerJoint,
    all_joints,
    held_places,
    joint_actions,
    joint_order,
    joint_values,
    short_name,
    whole_list,
)
from nw_policies.cards.model import CONTROL_RATE
from nw_policies.cards.motors import Motor, motor_places
from nw_scenes.robots import RobotSpec
from nw_scenes.robots.spec import Follow, remounted

_T = TypeVar("_T")

Action = NDArray[np.float64]
"""Raw action, one number for each joint in the order of `control.joints`."""


@dataclass(frozen=True, kw_only=True)
class JointControl:
    """A card's settings of actions, as arrays in the policy's joint order."""

    order: NDArray[np.intp]
    """(J,) for each joint of the policy, its index among the robot's joints."""
    names: tuple[str, ...]
    """(J,) of these joints."""
    kinds: tuple[ActionKind, ...]
    """(J,) what the action of each means."""
    default_pose: NDArray[np.float64]
    """(J,) rad."""
    base: NDArray[np.float64]
    """(J,) rad, the target of action 0: the default pose, or zeros for absolute actions."""
    scale: NDArray[np.float64]
    """(J,) rad, rad/s or N m for each unit of action."""
    low: float
    high: float
    """Limits of the raw action."""
    driven: NDArray[np.intp]
    """(A,) the indices, among these J, of joints that the policy drives; the others are held."""

    @classmethod
    def from_card(cls, card: Card, robot: RobotSpec) -> JointControl:
        """Resolve joint names and values against a robot.

        Raises:
            PolicyError: a joint is unknown or missing, or a list has another length.
        """
        control = card.control
        wanted = _named("held", lambda: all_joints(control.joints, control.held, robot.joints))
        order = _named("joints", lambda: joint_order(wanted, robot.joints))
        names = [robot.joints[i] for i in order]
        robot_pose = np.array(robot.default_pose)[order]
        pose = robot_pose
        if (own_pose := control.default_pose) is not None:
            pose = _named(
                "default_pose",
                lambda: joint_values(
                    whole_list(own_pose, control.joints, robot_pose.tolist()),
                    names,
                    robot_pose.tolist(),
                ),
            )
        held = _named("held", lambda: held_places(control.held, names))
        driven = [place for place in range(len(names)) if place not in held]
        acting = [names[place] for place in driven]
        kinds: list[ActionKind] = ["joint_position_offset"] * len(names)
        scale = np.zeros(len(names))
        if isinstance(control.scale, dict):  # It may name joints that are held.
            none = [0.0 if place in held else None for place in range(len(names))]
            scale[:] = _named("scale", lambda: joint_values(control.scale, names, none))
            scale[[*held]] = 0.0
        else:
            scale[driven] = _named("scale", lambda: joint_values(control.scale, acting))
        told = _named("action", lambda: joint_actions(control.action, acting))
        for place, kind in zip(driven, told, strict=True):
            kinds[place] = kind
        offset = np.array(kinds) == "joint_position_offset"
        base = np.where(offset, pose, 0.0)
        for place, angle in held.items():
            base[place] = pose[place] if angle is None else angle
        low, high = control.clip or (-np.inf, np.inf)
        return cls(
            order=order,
            names=tuple(names),
            kinds=tuple(kinds),
            default_pose=pose,
            base=base,
            scale=scale,
            low=low,
            high=high,
            driven=np.array(driven, dtype=np.intp),
        )

    def whole(self, action: Action) -> Action:
        """Return an action of the policy, (A,), with zeros for the joints that are held, (J,)."""
        if len(self.driven) == len(self.order):
            return action
        result = np.zeros(len(self.order))
        result[self.driven] = action
        return result

    def targets(self, action: Action) -> NDArray[np.float64]:
        """Return what the motors are told, in the robot's order: rad, rad/s or N m.

        Args:
            action: raw action in the policy's order, (J,).
        """
        # Right after a network has run, a few plain numbers cost 4 us and NumPy's calls 6.
        own: list[float] = action.tolist()
        low, high = self.low, self.high
        return np.array(
            [
                base + scale * (x if low <= (x := own[i]) <= high else min(max(x, low), high))
                for base, scale, i in self._rows
            ]
        )

    @cached_property
    def _rows(self) -> list[tuple[float, float, int]]:
        """Base, scale, and place in an action of each joint, in the robot's order."""
        places = np.argsort(self.order)
        return [(float(self.base[i]), float(self.scale[i]), int(i)) for i in places]


_FOLLOWS: dict[ActionKind, Follow] = {
    "joint_position_offset": "position",
    "joint_position": "position",
    "joint_velocity": "velocity",
    "joint_torque": "torque",
}


def motors_follow(card: Card, robot: RobotSpec) -> tuple[Follow, ...]:
    """Return the command kind of each motor of a robot, (J,) in the robot's joint order.

    Raises:
        PolicyError: a joint is unknown or has no action.
    """
    control = card.control
    held = _named("held", lambda: held_places(control.held, robot.joints))
    acting = [name for place, name in enumerate(robot.joints) if place not in held]
    kinds = iter(_named("action", lambda: joint_actions(control.action, acting)))
    return tuple(
        "position" if place in held else _FOLLOWS[next(kinds)] for place in range(len(robot.joints))
    )


def actuator_values(card: Card, robot: RobotSpec) -> dict[str, NDArray[np.float64]] | None:
    """Return the motor values that a card overrides; None if it overrides nothing.

    Returns:
        kp, kd, torque_limits, armature, friction_loss, viscous_friction: (J,) each in the robot's
        joint order, the keyword arguments of `sim.Actuators`. Motors of torques have no damping of
        their own.

    Raises:
        PolicyError: a joint is unknown, a list has another length, a value is negative, or a gain
            0 without which a motor cannot do what the card tells it.
    """
    control = card.control
    follows = motors_follow(card, robot)
    torques = "torque" in follows
    damping = tuple(
        0.0 if follow == "torque" else own
        for own, follow in zip(robot.joint_damping, follows, strict=True)
    )
    overrides: dict[str, tuple[PerJoint | None, tuple[float, ...]]] = {
        "kp": (control.kp, robot.kp),
        "kd": (control.kd, damping),
        "torque_limits": (control.torque_limits, robot.torque_limits),
        "armature": (control.armature, robot.armature),
        "friction_loss": (control.friction_loss, robot.friction_loss),
        "viscous_friction": (control.viscous_friction, (0.0,) * len(follows)),
    }
    robot_follows = robot.follows or ("position",) * len(follows)
    is_own = follows == robot_follows
    if is_own and not torques and all(value is None for value, _ in overrides.values()):
        return None
    wanted = _named("held", lambda: all_joints(control.joints, control.held, robot.joints))
    order = _named("joints", lambda: joint_order(wanted, robot.joints))
    names = [robot.joints[i] for i in order]
    result: dict[str, NDArray[np.float64]] = {}
    for key, (value, own) in overrides.items():
        values = np.array(own, dtype=np.float64)
        if value is not None:
            values[order] = _named(
                key,
                lambda v=value, o=values: joint_values(
                    whole_list(v, control.joints, o[order].tolist()), names, o[order].tolist()
                ),
            )
        if (values < 0).any():
            raise PolicyError(f"control.{key}: {values.min():g} is negative", fix="give 0 or more")
        result[key] = values
    for which, follow in (("kp", "position"), ("kd", "velocity")):
        lame = [
            short_name(name)
            for name, told, own, value in zip(
                robot.joints, follows, robot_follows, result[which], strict=True
            )
            if told == follow != own and not value
        ]
        if lame:
            raise PolicyError(
                f"control.action: {', '.join(lame[:8])} cannot follow a {follow}: {which} is 0",
                fix=f"give `{which}`, or another `action`, such as "
                '{"*": joint_position_offset, "*_wheel": joint_velocity}',
            )
    return result


def motor_groups(card: Card, robot: RobotSpec) -> list[tuple[Motor, NDArray[np.intp]]]:
    """Return the groups of motors that are more than servos, and their joints.

    Returns:
        For each group its joints' positions, (N,), among the robot's.

    Raises:
        PolicyError: a name means no joint, a joint is in two groups, or a network is for joints
            whose actions are no positions.
    """
    motors = card.control.motors or []
    places = _named("motors", lambda: motor_places(motors, robot.joints))
    follows = motors_follow(card, robot)
    for number, (motor, own) in enumerate(zip(motors, places, strict=True)):
        other = [robot.joints[place] for place in own if follows[place] != "position"]
        if motor.kind == "network" and other:
            raise PolicyError(
                f"control.motors: the network of group {number} takes errors of position, and "
                f"{short_name(other[0])} is told another thing",
                fix="leave it out of the group's `joints`, or correct `action`",
            )
    return list(zip(motors, places, strict=True))


def physics_steps(card: Card, protocol: EvaluationProtocol) -> tuple[float, int]:
    """Return the physics step, s, and how many of them make a control step.

    Raises:
        PolicyError: the card's physics rate is not that of the protocol, or its control steps.
    """
    rate = card.control.physics_rate
    if protocol.fixed_physics_rate and rate != PHYSICS_RATE:
        raise PolicyError(
            f"card {card.name!r}: control.physics_rate is {rate}, the protocol "
            f"{protocol.name!r} has {PHYSICS_RATE}",
            fix="remove it from the card, or use `protocol: strict` in the suite",
        )
    if protocol.fixed_physics_rate and card.control.step_rate != CONTROL_RATE:
        raise PolicyError(
            f"card {card.name!r}: control.rate is {card.control.rate}, the protocol "
            f"{protocol.name!r} has control steps of {1 / CONTROL_RATE:g} s",
            fix="use `protocol: strict` in the suite, or a policy with a rate that divides 50",
        )
    return 1.0 / rate, card.control.substeps


def _named(key: str, resolve: Callable[[], _T]) -> _T:
    """Call `resolve`, and say in its errors which key of `control` they are about."""
    try:
        return resolve()
    except PolicyError as error:
        raise PolicyError(f"control.{key}: {error}") from None


def mounted_robot(robot: RobotSpec, card: Card) -> RobotSpec:
    """Return a robot with its cameras as a card says.

    Raises:
        PolicyError: the robot has no such camera, or none sees so wide an angle.
    """
    if not card.cameras:
        return robot
    cameras = dict(robot.cameras)
    for name, mounting in card.cameras.items():
        if name not in cameras:
            raise PolicyError(
                f"cameras.{name}: {robot.name} has no camera {name!r}",
                fix=nearest(name, list(robot.cameras)),
            )
        own, lens = cameras[name], mounting.intrinsics
        own = replace(
            own if lens is None else own.with_intrinsics(lens),
            readout=own.readout if mounting.readout is None else mounting.readout,
            exposure=own.exposure if mounting.exposure is None else mounting.exposure,
        )
        try:
            cameras[name] = remounted(
                own,
                pitch=mounting.pitch,
                height=mounting.height,
                factor=mounting.field_of_view,
            )
        except ValueError as error:
            raise PolicyError(
                f"cameras.{name}.field_of_view {mounting.field_of_view:g}: {error}",
                fix="name a smaller factor",
            ) from None
    return replace(robot, cameras=cameras)
