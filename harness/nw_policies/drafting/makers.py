"""What makers of robots deploy their policies with: Booster's T1.yaml, LimX's params.yaml.

    common, policy              booster_gym
    PointfootCfg                tron1-rl-deploy-python, and those of other feet

Their scripts name the terms; the files have the scales. `configs` reads the files of projects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from nw_policies.cards.joints import short_name
from nw_policies.drafting.exporters import ExportedTerm, ExporterMetadata
from nw_policies.drafting.fields import Fields, per_second
from nw_scenes.robots import RobotSpec

_PLAIN = ExportedTerm(name="", scale=(1.0,), clip=(-math.inf, math.inf), history=1)


def is_booster(data: Fields) -> bool:
    """Return whether a file is that of Booster's deploy script."""
    common = data.get("common")
    policy = data.get("policy")
    return (
        isinstance(common, Fields)
        and "default_qpos" in common
        and isinstance(policy, Fields)
        and "num_actions" in policy
    )


def read_booster(data: Fields, robot: RobotSpec, _: Sequence[Fields]) -> ExporterMetadata:
    """Read it. Its lists are of all motors, of which a policy drives the last ones, the legs."""
    common, policy = data.below("common"), data.below("policy")
    count = int(policy.number("num_actions") or 0)
    own = [short_name(joint) for joint in robot.joints]
    names = tuple(own[-count:]) if 0 < count <= len(own) else ()
    control, norm = policy.below("control"), policy.below("normalization")
    step, every = common.number("dt"), control.number("decimation")
    clip = norm.number("clip_actions")
    cycles = policy.number("gait_frequency")
    linear, angular = norm.number("lin_vel") or 1.0, norm.number("ang_vel") or 1.0
    terms = [
        replace(_PLAIN, name="projected_gravity", scale=(norm.number("gravity") or 1.0,)),
        replace(_PLAIN, name="base_ang_vel", scale=(angular,)),
        replace(_PLAIN, name="commands", scale=(linear, linear, angular)),
        replace(
            _PLAIN,
            name="phase",
            keys=f"frequency: {cycles or 1:g}, values: [cosine, sine]",
        ),
        replace(_PLAIN, name="dof_pos", scale=(norm.number("dof_pos") or 1.0,)),
        replace(_PLAIN, name="dof_vel", scale=(norm.number("dof_vel") or 1.0,)),
        replace(_PLAIN, name="actions", keys="clipped: true" if clip else ""),
    ]

    def of_legs(key: str) -> tuple[float, ...]:
        return common.numbers(key)[-count:] if count else ()

    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=of_legs("stiffness"),
        joint_damping=of_legs("damping"),
        default_joint_pos=of_legs("default_qpos"),
        torque_limits=of_legs("torque_limit"),
        action="joint_position_offset",
        action_scale=control.numbers("action_scale"),
        action_clip=(-clip, clip) if clip else None,
        rate=per_second(step * every if step and every else None),
        observation_terms=tuple(terms),
        model=str(policy.get("policy_path") or ""),
        joint_count=count,
        input_size=int(policy.number("num_observations") or 0),
        notes=("its script lets commands change by a step's time at most, which a card cannot",),
    )


_LIMX = ("PointfootCfg", "SolefootCfg", "WheelfootCfg")


def is_limx(data: Fields) -> bool:
    """Return whether a file is that of a controller of LimX's biped."""
    return any(name in data for name in _LIMX)


def read_limx(data: Fields, _: RobotSpec, __: Sequence[Fields]) -> ExporterMetadata:
    """Read it. The policy sees what an encoder made of the last frames, a frame, and a command."""
    config = next(data.below(name) for name in _LIMX if name in data)
    names = tuple(map(short_name, config.texts("joint_names")))
    control, norm = config.below("control"), config.below("normalization")
    scales, clips = norm.below("obs_scales"), norm.below("clip_scales")
    speeds, size = config.below("user_cmd_scales"), config.below("size")
    pose = config.below("init_state").below("default_joint_angle")
    angles = [pose.number(name) for name in config.texts("joint_names")]
    rate, every = config.number("loop_frequency"), control.number("decimation")
    clip = clips.number("clip_actions")
    factors = {key: scales.number(key) or 1.0 for key in ("ang_vel", "dof_pos", "dof_vel")}
    encoded = int(size.number("encoder_output_size") or 0)
    faster = tuple(speeds.number(key) or 1.0 for key in ("lin_vel_x", "lin_vel_y", "ang_vel_yaw"))
    terms = [
        replace(_PLAIN, name="base_ang_vel", scale=(factors["ang_vel"],)),
        replace(_PLAIN, name="projected_gravity"),
        replace(_PLAIN, name="dof_pos", scale=(factors["dof_pos"],)),
        replace(_PLAIN, name="dof_vel", scale=(factors["dof_vel"],)),
        replace(_PLAIN, name="actions"),
        replace(_PLAIN, name="phase", keys="frequency: 2"),
        replace(_PLAIN, name="gait", width=4),
        replace(_PLAIN, name="commands", scale=faster),
    ]
    if encoded:
        terms.insert(0, replace(_PLAIN, name="encoder", width=encoded))
    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=control.numbers("stiffness"),
        joint_damping=control.numbers("damping"),
        default_joint_pos=tuple(angle or 0.0 for angle in angles),
        torque_limits=control.numbers("user_torque_limit"),
        action="joint_position_offset",
        action_scale=control.numbers("action_scale_pos"),
        action_clip=(-clip, clip) if clip else None,
        rate=rate / every if rate and every else None,
        observation_terms=tuple(terms),
        observation_clip=clips.number("clip_observations"),
        joint_count=len(names),
        notes=(
            (
                "its controller's gait is 2 Hz, offset 0.5, duration 0.5 and swing height 0.1 m: "
                "four constants of the term `gait`"
            ),
        ),
    )
