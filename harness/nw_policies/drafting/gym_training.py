"""Trainings in Isaac Gym: the classes of legged_gym's configuration, as forks save them in YAML.

walk-these-ways and dribblebot put all of it under `Cfg`. What the policy sees is not in such files,
but in code (`training_code`).
The joints are in the order of Isaac Gym, which sorts legs by their names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, cast

from nw_base.errors import PolicyError
from nw_policies.cards.joints import short_name
from nw_policies.drafting.exporters import ExporterMetadata
from nw_policies.drafting.fields import Fields, number_of, per_second
from nw_policies.drafting.layouts import LEG_BY_LEG
from nw_policies.drafting.motors import TOLD_LATE, Group, late_steps, named_network
from nw_policies.safety.archive import FileLimits
from nw_policies.safety.objects import read_index
from nw_scenes.robots import RobotSpec

IN_CODE = "the training computes what the policy sees in its own code"


def _config(data: Fields) -> Fields:
    inner = data.get("Cfg")
    return inner if isinstance(inner, Fields) else data


def pickled_settings(data: bytes, where: str) -> Fields:
    """Return the settings of a pickle; tensors and objects in it are nothing. Nothing is run.

    Raises:
        PolicyError: as `nw_policies.safety.objects.read_objects`.
    """
    tree = read_index(data, where, FileLimits(), pickled=True).tree
    try:
        return Fields(cast("dict[str, Any]", _plain(tree)) if isinstance(tree, dict) else {})
    except RecursionError:
        raise PolicyError(
            f"{where}: its mappings are nested too deep", fix="leave it out"
        ) from None


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in cast("dict[Any, Any]", value).items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in cast("list[Any]", value)]
    return value if isinstance(value, str | int | float) else None


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
        notes=(IN_CODE, *_drawn(config)),
    )


_DRAWN = (
    ("randomize_motor_strength", "motor_strength_range", "strength of its motors"),
    ("randomize_calculated_torque", "torque_multiplier_range", "factor of its torques"),
    ("randomize_Kp_factor", "Kp_factor_range", "factor of kp"),
    ("randomize_Kd_factor", "Kd_factor_range", "factor of kd"),
    ("randomize_pd_gains", "stiffness_multiplier_range", "factor of kp"),
    ("randomize_pd_gains", "damping_multiplier_range", "factor of kd"),
)
"""Switch, range and meaning of what trainings draw for each episode."""


def _drawn(config: Fields) -> Iterator[str]:
    """Give sentences of what of the motors was drawn in the training."""
    drawn = config.below("domain_rand")
    for switch, key, what in _DRAWN:
        limits = drawn.numbers(key)
        if drawn.get(switch) and len(limits) == 2 and limits[0] < limits[1]:
            middle = (limits[0] + limits[1]) / 2
            rest = f", not the middle, {middle:g}" if abs(middle - 1.0) > 1e-6 else ", the middle"
            yield f"the {what} was drawn from {limits[0]:g} to {limits[1]:g}: the card has 1{rest}"
    steps = drawn.numbers("range_cmd_action_latency")
    if drawn.get("add_cmd_action_latency") and len(steps) == 2:
        yield f"{TOLD_LATE.format(*steps)}: the card has the middle"
    if share := drawn.number("action_delay"):
        yield (
            f"a share of the action before was mixed in, drawn from 0 to {share:g}: the card has "
            "none"
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
    steps = drawn.numbers("range_cmd_action_latency")
    if drawn.get("add_cmd_action_latency") and len(steps) == 2:
        late = sum(steps) / 2
    delay = late_steps(late or 0.0, physics_rate)
    file = control.get("actuator_net_file")
    if control.get("control_type") == "actuator_net":
        return (named_network("unitree_go1.pt", delay=delay),)
    if control.get("use_actuator_network") and isinstance(file, str) and file:
        return (named_network(file, delay=delay),)
    return ({"joints": "*", "kind": "pd", "delay": delay},) if delay else ()
