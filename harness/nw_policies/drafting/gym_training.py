"""Trainings in Isaac Gym: the classes of legged_gym's configuration, as forks save them in YAML.

walk-these-ways and dribblebot put all of it under `Cfg`. What the policy sees is not in such files,
but in code (`training_code`).
The joints are in the order of Isaac Gym, which sorts legs by their names.
"""

from __future__ import annotations

from collections.abc import Sequence

from nw_policies.cards.joints import short_name
from nw_policies.drafting.checkpoint import ExporterMetadata
from nw_policies.drafting.fields import Fields, number_of, per_second
from nw_policies.drafting.layouts import LEG_BY_LEG
from nw_policies.drafting.motors import Group, late_steps, named_network
from nw_scenes.robots import RobotSpec

IN_CODE = "the training computes what the policy sees in its own code"


def _config(data: Fields) -> Fields:
    inner = data.get("Cfg")
    return inner if isinstance(inner, Fields) else data


def is_gym_training(data: Fields) -> bool:
    """Return whether a file is the configuration of such a training."""
    config = _config(data)
    control, start = config.get("control"), config.get("init_state")
    return (
        isinstance(control, Fields)
        and {"stiffness", "damping", "action_scale", "decimation"} <= set(control)
        and isinstance(start, Fields)
        and "default_joint_angles" in start
    )


def read_gym_training(data: Fields, robot: RobotSpec, _: Sequence[Fields]) -> ExporterMetadata:
    """Read it."""
    config = _config(data)
    control = config.below("control")
    names = [short_name(joint) for joint in robot.joints]
    if sorted(names) == sorted(LEG_BY_LEG):
        names = list(LEG_BY_LEG)
    pose = config.below("init_state").below("default_joint_angles")
    angles = [pose.number(name, f"{name}_joint") for name in names]
    step, every = config.below("sim").number("dt"), control.number("decimation")
    normal, ranges = config.below("normalization"), config.below("commands").below("ranges")
    clip = normal.number("clip_actions")
    speeds = {
        key: ranges.numbers(theirs)
        for key, theirs in (("lin_vel_x",) * 2, ("lin_vel_y",) * 2, ("ang_vel_z", "ang_vel_yaw"))
    }
    scale, hips = control.number("action_scale"), control.number("hip_scale_reduction")
    by_joint = [scale * (hips or 1.0) if "hip" in n else scale for n in names] if scale else []
    return ExporterMetadata(
        joint_names=tuple(names) if None not in angles else (),
        joint_stiffness=_by_part(control, "stiffness", names),
        joint_damping=_by_part(control, "damping", names),
        default_joint_pos=tuple(a for a in angles if a is not None) if None not in angles else (),
        action={"T": "joint_torque", "V": "joint_velocity"}.get(
            str(control.get("control_type")), "joint_position_offset"
        ),
        action_scale=tuple(by_joint) if hips else tuple(by_joint[:1]),
        action_clip=(-clip, clip) if clip else None,
        rate=per_second(step * every if step and every else None),
        physics_rate=per_second(step),
        speeds={key: (low[0], low[1]) for key, low in speeds.items() if len(low) == 2},
        observation_clip=normal.number("clip_observations"),
        motors=_motors(config, per_second(step)),
        guessed_order=None not in angles,
        notes=(IN_CODE,),
    )


def _by_part(control: Fields, key: str, names: Sequence[str]) -> tuple[float, ...]:
    """Return gains by parts of names, the first that is in a joint's."""
    parts = control.below(key)
    values = [
        next((number_of(parts[part]) for part in parts if part in f"{name}_joint"), None)
        for name in names
    ]
    known = tuple(value for value in values if value is not None)
    return known if len(known) == len(names) else ()


def _motors(config: Fields, physics_rate: float | None) -> tuple[Group, ...]:
    """Return the motors of walk-these-ways, whose actions may be late too, or of legged_gym."""
    control, drawn = config.below("control"), config.below("domain_rand")
    late = drawn.number("lag_timesteps") if drawn.get("randomize_lag_timesteps") else None
    delay = late_steps(late or 0.0, physics_rate)
    file = control.get("actuator_net_file")
    if control.get("control_type") == "actuator_net":
        return (named_network("unitree_go1.pt", delay=delay),)
    if control.get("use_actuator_network") and isinstance(file, str) and file:
        return (named_network(file, delay=delay),)
    return ({"joints": "*", "kind": "pd", "delay": delay},) if delay else ()
