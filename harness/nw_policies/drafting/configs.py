"""What the config files of exporters and trainings say of a policy, read as data.

    params/deploy.yaml          unitree_rl_lab, unitree_rl_mjlab
    env.yaml, agent.yaml, ...   trainings in Isaac Lab and mjlab (`environments`)
    config.yaml, base.yaml      rl_sar and quadruped_ros2_control; legged_rl_deploy
    *.yaml                      unitree_rl_gym's deploy configs, and those of its forks
    *.yaml                      controllers of legged_ros2
    NAME.json, asset_meta.json  muwanx, which runs policies in browsers
    T1.yaml, params.yaml        booster_gym; LimX's controllers (`makers`)
    config.yaml                 HumanoidVerse, ASAP, PBHC, FALCON (`humanoidverse`)

A file is known by its keys, not by its name. Nothing of a tag is executed: `!!python/tuple` is a
list. Lists for each joint are in the order of `joint_names`, whatever their order in the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, cast

from nw_policies.cards.joints import short_name
from nw_policies.drafting.environments import (
    action_kind,
    action_notes,
    activation_of,
    fields_of,
    manager_term,
    raw_limits,
    read_agent,
    read_descriptors,
    read_direct_environment,
    read_environment,
    scale_of,
    speeds_of,
)
from nw_policies.drafting.exporters import ExportedTerm, ExporterMetadata
from nw_policies.drafting.fields import (
    Fields,
    limits_of,
    numbers_of,
    per_second,
)
from nw_policies.drafting.gym_training import is_gym_training, read_gym_training
from nw_policies.drafting.humanoidverse import (
    is_humanoidverse,
    read_deployment,
    read_training,
)
from nw_policies.drafting.layouts import LEG_BY_LEG, RIGHT_FIRST, isaac_lab_order
from nw_policies.drafting.makers import is_booster, is_limx, read_booster, read_limx
from nw_policies.drafting.patterns import reordered
from nw_scenes.robots import RobotSpec

Data = Fields
Reader = Callable[[Data, RobotSpec, Sequence[Data]], ExporterMetadata]


def reader_of(data: Data) -> tuple[str, Reader | None]:
    """Return the kind of file, by its keys, and its reader."""
    inner = next((value for value in data.values() if isinstance(value, dict)), {})
    policy = data.below("policy")
    if isinstance(data.get("joint_ids_map"), list) and "step_dt" in data:
        return "deploy", _deploy
    if {"actions", "observations", "articulations"} <= set(data):
        return "io_descriptors", read_descriptors
    if isinstance(policy.get("joint_ids_map"), list) and "policy_dt" in policy:
        return "legged_rl_deploy", _legged_rl_deploy
    if any({"observations", "rl_kp"} <= set(words) for words in (inner, data)):
        return "rl_sar", _rl_sar
    gains = (
        {"kps", "kds", "default_angles"},
        {"kps", "kds", "default_joint_pos"},
        {"ctrl_kp", "ctrl_kd", "action_scale"},
    )
    about = {"policy_path", "policy_name", "num_obs", "num_single_obs"}
    if any(keys <= set(data) for keys in gains) and about & set(data):
        return "gym", _gym
    if any(
        {"obs_names", "obs_cfg", "action_cfg"} <= set(words) for words in _ros_nodes(data).values()
    ):
        return "legged_ros2", _legged_ros2
    if isinstance(data.get("obs_config"), dict) and {"stiffness", "action_scale"} <= set(data):
        return "muwanx", _muwanx
    return _reader_of_makers(data) or _reader_of_training(data)


def _reader_of_makers(data: Data) -> tuple[str, Reader] | None:
    if is_booster(data):
        return "booster", read_booster
    if is_limx(data):
        return "limx", read_limx
    kind = is_humanoidverse(data)
    readers = {"train": read_training, "deploy": read_deployment}
    return (f"humanoidverse_{kind}", readers[kind]) if kind else None


def _reader_of_training(data: Data) -> tuple[str, Reader | None]:
    if {"sim", "decimation", "observations", "actions"} <= set(data):
        return "env", read_environment
    if {"sim", "decimation", "robot", "observation_space"} <= set(data):
        return "env", read_direct_environment
    if is_gym_training(data):
        return "gym_training", read_gym_training
    return ("agent", read_agent) if activation_of(data) else ("", None)


def motor_names(robot: RobotSpec) -> tuple[str, ...]:
    """Return the joints as their maker counts the motors: Unitree's quadrupeds FR, FL, RR, RL."""
    own = [short_name(joint) for joint in robot.joints]
    return RIGHT_FIRST if sorted(own) == sorted(RIGHT_FIRST) else tuple(own)


def _mapped(places: Any, robot: RobotSpec) -> tuple[str, ...]:
    """Return the joints of a policy from the numbers of their motors; empty for another robot."""
    names, numbers = motor_names(robot), numbers_of(places)
    if sorted(numbers) != list(range(len(names))):
        return ()
    return tuple(names[int(number)] for number in numbers)


def _deploy(data: Data, robot: RobotSpec, _: Sequence[Data]) -> ExporterMetadata:
    """Read what unitree_rl_lab and unitree_rl_mjlab deploy with.

    `joint_ids_map` has the motor of each joint of the policy. Gains are in the order of the motors,
    all other lists in that of the policy.
    """
    names = data.texts("joint_names") or _mapped(data.get("joint_ids_map"), robot)
    motors = motor_names(robot)
    actions = data.below("actions")
    kind, action = next(iter(actions.items()), ("", {}))
    action = fields_of(action)
    described = data.below("observations")
    group = described.get("obs", described.get("policy"))
    if isinstance(group, Fields) and "history_length" not in group:
        described = group  # Of several groups, each with a name.
    by_step = described.get("use_gym_history") is True
    offset = action.numbers("offset")
    clip, clip_notes = raw_limits(action, names, action.numbers("scale"), offset)
    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=reordered(data.numbers("stiffness"), motors, names),
        joint_damping=reordered(data.numbers("damping"), motors, names),
        default_joint_pos=data.numbers("default_joint_pos"),
        action=action_kind(kind, offset),
        action_scale=action.numbers("scale"),
        action_clip=clip,
        rate=data.per_second("step_dt"),
        speeds=speeds_of(data.get("commands")),
        observation_terms=tuple(
            manager_term(name, fields_of(term), by_step=by_step)
            for name, term in described.items()
            if isinstance(term, dict)
        ),
        joint_count=len(data.numbers("joint_ids_map")),
        notes=(*action_notes(kind, offset, data.numbers("default_joint_pos")), *clip_notes),
    )


def _legged_rl_deploy(data: Data, robot: RobotSpec, _: Sequence[Data]) -> ExporterMetadata:
    """Read what legged_rl_deploy runs a policy with; its lists are in the policy's order."""
    policy = data.below("policy")
    names = _mapped(policy["joint_ids_map"], robot)
    kind, action = next(iter(policy.below("actions").items()), ("", {}))
    action = fields_of(action)
    described = policy.below("observations")
    stack = described.below("stack")
    steps = int(stack.number("length") or 1)
    order = stack.get("order") if stack.get("order") == "newest_first" else "oldest_first"
    command = policy.below("commands").below("base_velocity")
    low, high = command.numbers("min"), command.numbers("max")
    ranges = zip(
        ("lin_vel_x", "lin_vel_y", "ang_vel_z"), zip(low, high, strict=False), strict=False
    )
    first = action.texts("process_order")[:1] == ("clip",)
    action.doubt("max", action.get("max"), readable=first)
    command.doubt("max", command.get("max"), readable=len(low) == len(high) == 3)
    offset = action.numbers("offset")

    def term(name: str, words: Data) -> ExportedTerm:
        scale = list(scale_of(words, "scale") or ())
        bounds = [*words.numbers("min"), *words.numbers("max")]
        steps_of = words.texts("process_order")
        if "scale" in steps_of and steps_of[-1:] == ("clip",):
            # A card clips first. Limits of what is scaled by several factors are not kept.
            one = scale[0] if len(set(scale)) == 1 else 0.0
            words.doubt("max", words.get("max"), readable=bool(one))
            bounds = [bound / one for bound in bounds] if one else []
        cycle = words.below("params").number("cycle_time")
        return ExportedTerm(
            name=name.removesuffix("_B"),
            scale=tuple(scale) or None,
            clip=limits_of(bounds) or (-math.inf, math.inf),
            history=steps,
            form=f"order: {order}, by: step",
            keys=f"frequency: {1 / cycle:g}" if cycle else "",
        )

    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=policy.numbers("stiffness"),
        joint_damping=policy.numbers("damping"),
        default_joint_pos=offset if any(offset) else (),
        action=action_kind(kind, offset),
        action_scale=action.numbers("scale"),
        action_clip=limits_of([*action.numbers("min"), *action.numbers("max")]) if first else None,
        rate=policy.per_second("policy_dt"),
        physics_rate=data.per_second("ll_dt"),
        speeds=dict(ranges) if len(low) == len(high) == 3 else {},
        observation_terms=tuple(
            term(name, fields_of(words)) for name, words in described.below("terms").items()
        ),
        model=str(policy.get("model_path") or ""),
        notes=action_notes(kind, (), ()),
        joint_count=len(policy.numbers("joint_ids_map")),
    )


_SAR_SCALES = {
    "lin_vel": "lin_vel_scale",
    "ang_vel": "ang_vel_scale",
    "dof_pos": "dof_pos_scale",
    "dof_vel": "dof_vel_scale",
    "commands": "commands_scale",
}


def _rl_sar(data: Data, robot: RobotSpec, others: Sequence[Data]) -> ExporterMetadata:
    """Read what rl_sar runs a policy with: `config.yaml`, and the robot's `base.yaml`.

    `joint_mapping` has the robot's joint of each joint of the policy; lists are in the policy's
    order. quadruped_ros2_control writes the same without the name above it. Its controller's own
    file has the rate of the physics; its `stand_pos` is no pose of a training.
    """
    name, value = next(((key, v) for key, v in data.items() if "rl_kp" in fields_of(v)), ("", data))
    config = fields_of(value)
    if name:
        named = name.split("/")[0]
        base = next((other.below(named) for other in others if named in other), Fields())
    else:
        nodes = (pair for other in others for pair in _ros_nodes(other).items())
        node = next((node for key, node in nodes if key.startswith("rl_")), Fields())
        frequency = node.number("update_rate")
        base = Fields({"dt": 1 / frequency if frequency else None})
    joints = base.texts("joint_names") or motor_names(robot)
    mapping = [int(number) for number in config.numbers("joint_mapping")]
    names = tuple(joints[n] for n in mapping) if sorted(mapping) == list(range(len(joints))) else ()
    is_guess = not names and sorted(motor_names(robot)) == sorted(LEG_BY_LEG)
    if is_guess:  # Isaac Gym sorts the legs by name; robot_lab has those of the right first.
        names = LEG_BY_LEG if config.get("framework") == "isaacgym" else RIGHT_FIRST
    past = [int(number) for number in config.numbers("observations_history")]
    steps = len(past) or 1
    # The latest is 0 there; in the older form of the file it is the largest number.
    newest = past[:1] == [0 if name else steps - 1] and steps > 1
    by = "term" if config.get("observations_history_priority") == "term" else "step"
    form = f"order: {'newest_first' if newest else 'oldest_first'}, by: {by}"
    period = [base.number(key) or config.number(key) for key in ("dt", "decimation")]
    low, high = (
        config.numbers("clip_actions_lower"),
        config.numbers("clip_actions_upper"),
    )
    scale = config.numbers("action_scale")
    terms = [
        ExportedTerm(
            name=word,
            scale=scale_of(config, _SAR_SCALES.get(word, "")),
            clip=(-math.inf, math.inf),
            history=steps,
            form=form,
            keys="clipped: true" if word == "actions" and low and high else "",
        )
        for word in config.texts("observations")
    ]
    count = int(config.number("num_of_dofs") or base.number("num_of_dofs") or len(robot.joints))
    hips = [int(place) for place in config.numbers("hip_scale_reduction_indices")]
    less = config.number("hip_scale_reduction")
    if less is not None and less != 1.0 and len(scale) == 1:
        scale = tuple(scale[0] * (less if place in hips else 1.0) for place in range(count))
    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=config.numbers("rl_kp"),
        joint_damping=config.numbers("rl_kd"),
        default_joint_pos=config.numbers("default_dof_pos") or base.numbers("default_dof_pos"),
        action="joint_position_offset",
        action_scale=scale,
        action_clip=(max(low), min(high)) if low and high else None,
        torque_limits=config.numbers("torque_limits") or base.numbers("torque_limits"),
        rate=round(1 / (period[0] * period[1]), 6) if all(period) else None,  # type: ignore[operator]
        physics_rate=per_second(period[0]),
        observation_terms=tuple(terms),
        observation_clip=config.number("clip_obs"),
        motion_file=str(config.get("motion_file") or ""),
        model=str(config.get("model_name") or ""),
        joint_count=count,
        guessed_order=is_guess,
    )


_GYM_TERMS = ("ang_vel", "projected_gravity", "commands", "dof_pos", "dof_vel", "actions")


_OTHER_GYM_TERMS = ("commands", "projected_gravity", "ang_vel", "dof_pos", "dof_vel", "actions")
"""Of go2_deploy, which deploys what LeggedGym-Ex trains."""


_HIM_TERMS = ("commands", "ang_vel", "projected_gravity", "dof_pos", "dof_vel", "actions")
"""Of HIMLoco and forks with a deploy script."""


def _gym(data: Data, robot: RobotSpec, _: Sequence[Data]) -> ExporterMetadata:
    """Read the deploy configs of unitree_rl_gym, its forks, and of go2_deploy.

    The terms are those of their deploy scripts, in their order.
    """
    is_other = "ctrl_kp" in data
    pose = data.numbers("default_angles", "stand_pos", "default_joint_pos")
    joints = int(data.number("num_actions") or len(pose))
    command = scale_of(data, "cmd_scale", "command_scale")
    if data.first("cmd_scale", "command_scale")[1] is None and "lin_vel_scale" in data:
        lin, ang = data.number("lin_vel_scale"), data.number("ang_vel_scale")
        command = None if lin is None or ang is None else (lin, lin, ang)
    scales = {
        "ang_vel": scale_of(data, "ang_vel_scale", "obs_scales_ang_vel"),
        "commands": command,
        "dof_pos": scale_of(data, "dof_pos_scale", "obs_scales_dof_pos"),
        "dof_vel": scale_of(data, "dof_vel_scale", "obs_scales_dof_vel"),
    }
    clip = data.number("clip_actions", "action_clip")
    steps = int(data.number("frame_stack", "history_length") or 1)
    size, whole, notes = (
        data.number("num_single_obs", "obs_size_single"),
        data.number("num_obs"),
        (),
    )
    size = whole if size is None else size
    terms_of_script = _OTHER_GYM_TERMS if is_other else _GYM_TERMS
    order = "oldest_first"
    frame, frames = data.number("num_obs_current"), data.number("num_obs_encoder")
    if frame and frames and frames % frame == 0:
        # HIMLoco's estimator sees several frames, its actor the newest of them.
        size, steps, order = frame, int(frames / frame), "newest_first"
        terms_of_script = _HIM_TERMS
    if size in {steps * (9 + 3 * joints), steps * (11 + 3 * joints)}:
        size /= steps  # Some count all frames.
    # Isaac Lab has the frames of each term in a row.
    by = "term" if any("isaac" in key for key in data) else "step"
    term = ExportedTerm(
        name="", clip=(-math.inf, math.inf), history=steps, form=f"order: {order}, by: {by}"
    )
    terms = [
        replace(
            term,
            name=name,
            scale=scales.get(name, (1.0,)),
            width=joints if name in {"dof_pos", "dof_vel", "actions"} else 3,
            keys="clipped: true" if name == "actions" and clip else "",
        )
        for name in terms_of_script
    ]
    if size == 11 + 3 * joints:
        # Sine and cosine of a phase of 0.8 s, as its deploy scripts have it.
        terms.append(replace(term, name="phase", scale=(1.0,), width=2, keys="frequency: 1.25"))
    elif size is not None and size != 9 + 3 * joints:
        # Its script sees something else, which the file does not say; the rest of it holds.
        notes = (f"a config of {size:g} numbers names no terms: see the script that reads it",)
        rest = int(size) - 9 - 3 * joints
        if is_other and 0 < rest <= 1000:  # Its scripts append what else they see.
            terms.append(replace(term, name="what_the_script_adds", scale=(1.0,), width=rest))
        else:
            terms = []
    step, every = data.number("simulation_dt", "sim_dt"), data.number("control_decimation")
    period = step * every if step and every else data.number("control_dt", "dt")
    names, is_guess = _gym_joints(data, robot, pose)
    # Where the script permutes, gains and pose are in the order of the motors.
    pose = reordered(pose, _list_order(pose, robot) or names, names) if pose else ()
    scale = data.numbers("action_scale")
    less = data.number("hip_scale_reduction")
    if less is not None and less != 1.0 and len(scale) == 1:
        scale = tuple(scale[0] * (less if "hip" in name else 1.0) for name in names)
    fastest, keys = data.numbers("max_cmd"), ("lin_vel_x", "lin_vel_y", "ang_vel_z")
    speeds = {key: (-most, most) for key, most in zip(keys, fastest, strict=False)}
    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=data.numbers("kps", "ctrl_kp"),
        joint_damping=data.numbers("kds", "ctrl_kd"),
        default_joint_pos=pose,
        action="joint_position_offset",
        action_scale=scale,
        action_clip=(-clip, clip) if clip else None,
        rate=per_second(period),
        physics_rate=per_second(step),
        speeds=speeds or speeds_of({"": {"ranges": data.below("command_range")}}),
        observation_terms=tuple(terms),
        observation_clip=data.number("clip_observations"),
        model=str(data.first("policy_path", "policy_name")[1] or ""),
        joint_count=joints,
        input_size=int(size or 0),
        guessed_order=is_guess,
        notes=notes,
    )


def _gym_joints(
    data: Data, robot: RobotSpec, pose: Sequence[float]
) -> tuple[tuple[str, ...], bool]:
    """Return the joints of a policy, and whether their order is a guess."""
    own = [short_name(joint) for joint in robot.joints]
    listed = data.texts("model_joint_names") or data.texts("joint_names")
    if sorted(map(short_name, listed)) == sorted(own):
        return tuple(map(short_name, listed)), False
    for key in ("joint2motor_idx", "leg_joint2motor_idx"):
        if mapped := _mapped(data.get(key), robot):
            return mapped, False
    if mapped := _permuted(data, robot):
        return mapped
    if sorted(own) != sorted(LEG_BY_LEG):
        return (tuple(own) if len(own) == len(pose) else ()), False
    if "ctrl_kp" in data:
        return motor_names(robot), False  # go2_deploy gives the motors what the policy gives.
    return LEG_BY_LEG, True  # Isaac Gym sorts the legs by name.


def _permuted(data: Data, robot: RobotSpec) -> tuple[tuple[str, ...], bool] | None:
    """Return the joints of a policy that a script's permutation of MuJoCo's joints gives.

    Which of both directions a list has is told by Isaac Lab's order; else it is a guess.
    """
    own = [short_name(joint) for joint in robot.joints]
    own = list(LEG_BY_LEG) if sorted(own) == sorted(LEG_BY_LEG) else own
    for key in ("sdk2isaac_idx", "mujoco_to_isaac_map", "isaac_to_mujoco_map", "mapping_joints"):
        places = [int(place) for place in data.numbers(key)]
        if sorted(places) != list(range(len(own))):
            continue
        ways = [tuple(own[place] for place in places)]
        ways.append(tuple(own[places.index(place)] for place in range(len(own))))
        lab = isaac_lab_order(robot)
        return (lab, False) if lab in ways else (ways[0], True)
    return None


def _list_order(pose: Sequence[float], robot: RobotSpec) -> tuple[str, ...]:
    """Return the order of a quadruped's joints that its pose shows by the signs of its hips."""
    if sorted(short_name(joint) for joint in robot.joints) != sorted(LEG_BY_LEG):
        return ()
    hips = pose[::3] if len(pose) == len(LEG_BY_LEG) else ()
    # Legs of the robot's left stand out with a positive hip.
    left = [hip > 0 for hip in hips if 0 < abs(hip) < 0.5]
    orders = (([True, False] * 2, LEG_BY_LEG), ([False, True] * 2, RIGHT_FIRST))
    return next((order for signs, order in orders if signs == left), ())


def _ros_nodes(data: Data) -> dict[str, Data]:
    """Return the parameters of each node of a file for ROS 2, by the node's name."""
    return {name: fields_of(node).below("ros__parameters") for name, node in data.items()}


def _legged_ros2(data: Data, _: RobotSpec, __: Sequence[Data]) -> ExporterMetadata:
    """Read the controller's file of legged_ros2, which Legged Lab exports with a policy."""
    nodes = _ros_nodes(data).values()
    config = next(node for node in nodes if "obs_cfg" in node and "action_cfg" in node)
    names = tuple(map(short_name, config.texts("joint_names")))
    actions = {short_name(key): fields_of(v) for key, v in config.below("action_cfg").items()}

    def per_joint(key: str) -> tuple[float, ...]:
        values = [actions.get(name, Fields()).number(key) for name in names]
        return () if None in values else tuple(cast("list[float]", values))

    described = config.below("obs_cfg")
    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=per_joint("kp"),
        joint_damping=per_joint("kd"),
        default_joint_pos=per_joint("default_pos"),
        action="joint_position_offset",
        action_scale=per_joint("scale"),
        rate=config.number("update_rate"),
        observation_terms=tuple(
            manager_term(name, described.below(name)) for name in config.texts("obs_names")
        ),
        joint_count=len(names),
    )


_MUWANX_TERMS = {
    "BaseLinearVelocity": "base_lin_vel",
    "BaseAngularVelocity": "base_ang_vel",
    "ProjectedGravity": "projected_gravity",
    "JointPositions": "joint_pos",
    "JointVelocities": "joint_vel",
    "PreviousActions": "last_action",
    "SimpleVelocityCommand": "velocity_command",
}


def _muwanx(data: Data, _: RobotSpec, others: Sequence[Data]) -> ExporterMetadata:
    """Read what muwanx runs a policy with: `NAME.json`, and the robot's `asset_meta.json`.

    Terms are read of the first group that has none but known ones; the others feed inputs of their
    own, and a note names them. The file does not say which of several frames comes first.
    """
    asset = next((other for other in others if "joint_names_isaac" in other), Fields())
    names = tuple(map(short_name, asset.texts("joint_names_isaac")))
    is_torque = data.get("control_type") == "torque"
    terms: tuple[ExportedTerm, ...] = ()
    notes: list[str] = []
    for group, value in data.below("obs_config").items():
        listed = cast("list[Any]", value) if isinstance(value, list) else []
        words = [fields_of(term) for term in listed]
        unknown = [str(w.get("name")) for w in words if w.get("name") not in _MUWANX_TERMS]
        if terms or unknown or not words:
            what = ", ".join(unknown) or "its terms"
            notes.append(f"of the JSON beside it the group {group} was not read: {what}")
            continue
        terms = tuple(_muwanx_term(w) for w in words)
        if any((term.history or 1) > 1 for term in terms):
            notes.append("the JSON beside it does not say which frame comes first")
        if any("subtract_default" not in w for w in words if w.get("name") == "JointPositions"):
            notes.append(
                "the JSON beside it does not say whether joint positions count from the default "
                "pose (`subtract_default`); the card has it so"
            )
        if any(w.get("transpose") is True for w in words):
            notes.append(
                "`transpose` in the JSON beside it was not read: frames of a joint in a row"
            )
    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=data.numbers("stiffness"),
        joint_damping=data.numbers("damping"),
        default_joint_pos=asset.numbers("default_joint_pos") if names else (),
        action="joint_torque" if is_torque else "joint_position_offset",
        action_scale=data.numbers("action_scale"),
        observation_terms=terms,
        joint_count=len(names),
        notes=tuple(notes),
    )


def _muwanx_term(words: Data) -> ExportedTerm:
    is_absolute = words.get("subtract_default") is False
    return ExportedTerm(
        name=_MUWANX_TERMS[str(words["name"])],
        scale=scale_of(words, "scale"),
        clip=(-math.inf, math.inf),
        history=min(max(int(words.number("history_steps") or 1), 1), 100),
        function="joint_pos" if is_absolute else "",
    )
