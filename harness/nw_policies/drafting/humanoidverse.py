"""What HumanoidVerse, and what grew from it, say of a policy: ASAP, PBHC and FALCON.

    config.yaml of a training   robot.dof_names, obs.obs_dict, obs.obs_auxiliary
    sim2real/config/*.yaml      obs_dict, obs_scales, history_length_dict

Terms stand in the order of their names, whatever their order in the file (`parse_observation` of
`humanoidverse/envs/env_utils`). A history of a training has the frames before the present one, the
newest first, term by term, and zeros before the first; that of a deployment has the present one
last. Ankles and hips are named in Unitree's order, which is the robot's own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from nw_policies.cards.joints import short_name
from nw_policies.drafting.exporters import ExportedTerm, ExporterMetadata
from nw_policies.drafting.fields import Fields, number_of, per_second
from nw_policies.drafting.notation import number, quoted
from nw_scenes.robots import RobotSpec

_STANDING = "standing: {below: 0.1, phase: 0}"
_DEPLOYED = (0.25, 50.0)
"""Action scale and rate of the deploy scripts, whose configuration does not name them."""


@dataclass(frozen=True, kw_only=True)
class _Body:
    """What terms need of the rest of a file."""

    names: tuple[str, ...]
    """Of the joints, in the policy's order."""
    upper: tuple[str, ...]
    """Those that the command moves."""
    pose: Mapping[str, float]
    height: float
    """m, commanded where nothing else is."""
    period: float | None
    """s of a gait."""
    actions: int


def is_humanoidverse(data: Fields) -> str:
    """Return which of the two files it is, `train` or `deploy`; empty if neither."""
    robot, seen = data.get("robot"), data.get("obs")
    if isinstance(robot, Fields) and isinstance(seen, Fields):
        return "train" if {"dof_names"} <= set(robot) and {"obs_dict"} <= set(seen) else ""
    return "deploy" if {"obs_dict", "obs_scales", "dof_names", "JOINT_KP"} <= set(data) else ""


def read_training(data: Fields, robot: RobotSpec, _: Sequence[Fields]) -> ExporterMetadata:
    """Read the configuration of a training."""
    about, seen = data.below("robot"), data.below("obs")
    names = tuple(map(short_name, about.texts("dof_names")))
    control = about.below("control")
    pose = about.below("init_state").below("default_joint_angles")
    angles = {short_name(name): pose.number(name) or 0.0 for name in pose}
    body = _Body(
        names=names,
        upper=tuple(map(short_name, about.texts("upper_dof_names"))),
        pose=angles,
        height=0.75,
        period=None,
        actions=_count(about.number("actions_dim"), names),
    )
    listed, scales = seen.below("obs_dict").texts("actor_obs"), seen.below("obs_scales")
    kept = {name: seen.below("obs_auxiliary").below(name) for name in listed if "history" in name}
    clip = max(control.number("action_clip_value") or 0.0, 0.0)
    terms: list[ExportedTerm] = []
    for name in sorted(listed):
        if name not in kept:
            terms.append(_term(name, scales, body, clipped=bool(clip)))
            continue
        for past in sorted(kept[name]):
            steps = _steps(kept[name].number(past))
            earlier = _term(past, scales, body, clipped=bool(clip))
            form = "order: newest_first, by: term, current: false, start: zeros"
            terms.append(replace(earlier, history=steps, form=form, keeps_one=True))
    simulation = data.below("simulator").below("config").below("sim")
    rate, every = simulation.number("fps"), simulation.number("control_decimation")
    motion = about.below("motion").get("motion_file")
    delay = data.below("domain_rand")
    late = delay.limits("ctrl_delay_step_range") if delay.get("randomize_ctrl_delay") else None
    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=_by_part(control.below("stiffness"), names),
        joint_damping=_by_part(control.below("damping"), names),
        default_joint_pos=tuple(angles.get(name, 0.0) for name in names),
        torque_limits=about.numbers("dof_effort_limit_list"),
        armature=about.numbers("dof_armature_list"),
        action="joint_torque" if control.get("control_type") == "T" else "joint_position_offset",
        action_scale=control.numbers("action_scale"),
        action_clip=(-clip, clip) if clip else None,
        rate=rate / every if rate and every else None,
        physics_rate=rate,
        observation_terms=tuple(terms),
        motion_file=motion if isinstance(motion, str) else "",
        motion_joints=names if len(names) < len(robot.joints) else (),
        joint_count=len(names),
        notes=()
        if late is None
        else (f"its targets came {late[0]:g} to {late[1]:g} physics steps late",),
    )


def read_deployment(data: Fields, robot: RobotSpec, _: Sequence[Fields]) -> ExporterMetadata:
    """Read the configuration that sim2real scripts run a policy with."""
    named = tuple(map(short_name, data.texts("dof_names")))
    own = tuple(map(short_name, robot.joints))
    # Lists are by the number of the motor. FALCON's names of hips are in another order than those.
    names = own if sorted(named) == sorted(own) else named
    upper = tuple(map(short_name, data.texts("dof_names_upper_body")))
    lower = tuple(map(short_name, data.texts("dof_names_lower_body")))
    dims, scales = data.below("obs_dims"), data.below("obs_scales")
    actions = _count(dims.number("actions"), names)
    pose = dict(zip(names, data.numbers("DEFAULT_DOF_ANGLES"), strict=False))
    body = _Body(
        names=names,
        upper=upper,
        pose=pose,
        height=data.number("DESIRED_BASE_HEIGHT") or 0.75,
        period=data.number("GAIT_PERIOD"),
        actions=actions,
    )
    steps = _steps(data.below("history_length_dict").number("actor_obs"))
    terms = [
        replace(
            _term(name, scales, body, clipped=True),
            history=steps,
            form="order: oldest_first, by: step, start: zeros",
        )
        for name in sorted(data.below("obs_dict").texts("actor_obs"))
    ]
    residual = data.get("residual_upper_body_action") is True
    scale, rate = _DEPLOYED
    said = f"its script multiplies actions by {scale:g} and runs {rate:g} times a second"
    notes = [f"{said}, which the file does not say"]
    if names != named:
        notes.append("it names joints in another order than its lists have, the motors'")
    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=data.numbers("JOINT_KP"),
        joint_damping=data.numbers("JOINT_KD"),
        default_joint_pos=data.numbers("DEFAULT_DOF_ANGLES"),
        torque_limits=data.numbers("motor_effort_limit_list"),
        action="joint_position_offset",
        action_scale=(scale,),
        action_clip=(-100.0, 100.0),
        rate=rate,
        physics_rate=per_second(data.number("SIMULATE_DT")),
        observation_terms=tuple(terms),
        commanded=upper if residual else (),
        model=str(data.get("model_path") or ""),
        joint_count=len(lower) if actions == len(lower) < len(names) else len(names),
        notes=tuple(notes),
    )


def _term(name: str, scales: Fields, body: _Body, *, clipped: bool) -> ExportedTerm:
    """Return a term of the two files as a card has it; one without `own` where it has none."""
    factor = scales.number(name)
    joints = len(body.names)
    clock = "" if body.period is None else f"frequency: {1.0 / body.period:.6g}, {_STANDING}"
    waist = [joint for joint in body.names if re.search("waist", joint)]
    targets = {
        "command_base_height": {"height": body.height},
        "command_waist_dofs": dict.fromkeys(waist, 0.0),
        "ref_upper_dof_pos": {joint: body.pose.get(joint, 0.0) for joint in body.upper},
    }
    known: dict[str, tuple[str, int, str]] = {
        "base_lin_vel": ("lin_vel", 3, ""),
        "base_ang_vel": ("ang_vel", 3, ""),
        "projected_gravity": ("gravity", 3, ""),
        "command_lin_vel": ("command", 2, "parts: [vx, vy]"),
        "command_ang_vel": ("command", 1, "parts: [yaw]"),
        "command_stand": ("moving", 1, ""),
        "dof_pos": ("joint_pos", joints, "leave_out: []" if body.actions < joints else ""),
        "dof_vel": ("joint_vel", joints, "leave_out: []" if body.actions < joints else ""),
        "actions": ("last_output", body.actions, "clipped: true" if clipped else ""),
        "ref_motion_phase": ("phase", 1, ""),
    }
    for called, values in (("sin_phase", "sine"), ("cos_phase", "cosine"), ("phase_time", "phase")):
        if clock:
            known[called] = ("clock", 1, f"{clock}, values: [{values}]")
    for called, of in targets.items():
        if of:
            pairs = ", ".join(f"{quoted(key)}: {number(value)}" for key, value in of.items())
            known[called] = ("target", len(of), f"of: {{{pairs}}}")
    word, width, keys = known.get(name, ("", 0, ""))
    return ExportedTerm(
        name=name,
        own=word,
        width=width or None,
        keys=keys,
        scale=(1.0 if factor is None else factor,),
        clip=(-math.inf, math.inf),
        history=1,
    )


def _by_part(values: Fields, names: Sequence[str]) -> tuple[float, ...]:
    """Return a value for each joint, by the key that its name contains; empty if one has none."""
    listed: list[Any] = []
    for name in names:
        hits = [key for key in values if key in name]
        # The longest: `hip_yaw` before `hip`.
        listed.append(number_of(values.get(max(hits, key=len))) if hits else None)
    return () if None in listed else tuple(listed)


def _steps(count: float | None) -> int:
    """Return a number of frames as a card may have it."""
    return int(min(max(count or 1.0, 1.0), 100.0))


def _count(count: float | None, names: Sequence[str]) -> int:
    """Return a number of joints: those of the file, where it says none or more."""
    return int(count) if count and 1.0 <= count <= len(names) else len(names)
