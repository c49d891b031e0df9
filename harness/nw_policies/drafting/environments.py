"""What trainings in Isaac Lab and mjlab say of a policy, and what their managers call a term.

params/env.yaml, agent.yaml Isaac Lab, mjlab, rsl_rl, skrl, rl_games
IO_descriptors.yaml         Isaac Lab
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any, cast

from nw_policies.cards.joints import short_name
from nw_policies.drafting.exporters import ExportedTerm, ExporterMetadata, HeightGrid
from nw_policies.drafting.fields import Fields, limits_of, per_second
from nw_policies.drafting.layouts import TERM_OF, isaac_lab_order
from nw_policies.drafting.motors import motor_groups, with_limits
from nw_policies.drafting.patterns import Patterns, matching, reordered
from nw_policies.drafting.tracking import MOTION_COMMAND
from nw_scenes.robots import RobotSpec

Data = Fields
IN_CODE = "the environment computes what the policy sees in its own code"


def fields_of(value: Any) -> Fields:
    """Return a mapping of a file; an empty one of what is none."""
    return value if isinstance(value, Fields) else Fields()


def scale_of(data: Data, *keys: str) -> tuple[float, ...] | None:
    """Return the factor of a term; 1 where nothing says it, None where it cannot be read."""
    return (data.numbers(*keys) or None) if data.first(*keys)[1] is not None else (1.0,)


def speeds_of(commands: Any) -> dict[str, tuple[float, float]]:
    """Return the ranges of a velocity command, wherever they stand below `commands`."""
    for command in fields_of(commands).values():
        ranges = fields_of(command).below("ranges")
        speeds = {
            key: limits
            for key in ("lin_vel_x", "lin_vel_y", "ang_vel_z")
            if len(limits := ranges.numbers(key)) == 2
        }
        if speeds:
            return speeds
    return {}


def action_kind(kind: str, offset: Sequence[float]) -> str:
    """Return what an action means, as a card writes it, by its class and its offset."""
    if re.search("effort|torque", kind, re.IGNORECASE):
        return "joint_torque"
    is_absolute = bool(offset) and not any(offset)
    return "joint_position" if is_absolute else "joint_position_offset"


def action_notes(kind: str, offset: Sequence[float], pose: Sequence[float]) -> tuple[str, ...]:
    """Return what of an action is none of a card's: targets of another kind, or from elsewhere."""
    notes: list[str] = []
    if kind != "None" and not re.search(
        r"(^|[.:])joint_?pos(ition)?(_?action)?$|effort|torque", kind, re.IGNORECASE
    ):
        notes.append(f"its action is {kind}: the card takes it for positions of joints")
    elif any(offset) and pose and {*offset} != {*pose}:
        notes.append(f"its actions count from {list(offset)}, the card's from the default pose")
    return tuple(notes)


_FAR = 10.0
"""rad or rad/s beyond which a limit of targets limits no joint."""


def raw_limits(
    action: Data, names: Sequence[str], scale: Sequence[float], base: Sequence[float]
) -> tuple[tuple[float, float] | None, tuple[str, ...]]:
    """Return the limits of raw actions by those of targets, which Isaac Lab has; and notes.

    It clips what the scale and the offset have made (`JointAction.process_actions`). A card has one
    pair for the raw actions of all joints: where they have different ones, a note names them.

    Args:
        action: of a file, whose `clip` is a pair, one for each joint, or pairs by patterns.
        names: of its joints.
        scale: for each unit of action; one number or one each.
        base: targets at action 0, alike; empty = 0.
    """
    if not names:  # Of another robot.
        return None, ()
    pairs = _pairs_of(action, names)
    if not pairs or len(scale) not in {1, len(names)} or not all(scale):
        action.doubt("clip", action.get("clip"))
        return None, ()
    if min(abs(limit) for pair in pairs for limit in pair) >= _FAR:
        return None, ()
    whole = zip(pairs, cycle(scale), cycle(base or (0.0,)), strict=False)
    raw = {tuple(sorted(round((x - b) / s, 6) for x in pair)) for pair, s, b in whole}
    if len(raw) == 1:
        low, high = raw.pop()
        return (low, high), ()
    shown = ", ".join(
        f"{short_name(name)} {low:g} to {high:g}"
        for name, (low, high) in zip(names, pairs, strict=True)
    )
    return None, (
        f"its targets are limited, and a card limits raw actions of all joints alike: {shown}",
    )


def _pairs_of(action: Data, names: Sequence[str]) -> list[tuple[float, float]]:
    """Return the limits of each joint's target; empty where there are none, or not of all."""
    clip = action.get("clip")
    if isinstance(clip, Fields):
        keys = [matching(clip, short_name(name)) for name in names]
        found = [clip.limits(key) if key else (-math.inf, math.inf) for key in keys]
    elif isinstance(clip, list) and len(listed := cast("list[Any]", clip)) == len(names) != 2:
        found = [limits_of(pair) for pair in listed]
    else:
        found = [limits_of(clip)] * len(names)
    return [] if None in found else cast("list[tuple[float, float]]", found)


def manager_term(
    name: str,
    term: Data,
    *,
    by_step: bool = False,
    function: str = "",
    steps: float | None = None,
) -> ExportedTerm:
    """Return a term of Isaac Lab's observation manager, or of one like it."""
    scale = scale_of(term, "scale")
    limits = term.limits("clip")
    steps = steps or term.number("history_length")
    params = term.below("params")
    period, skipped = params.number("period"), params.number("history_skip_frames") or 0.0
    flat = term.get("flatten_history_dim")
    return ExportedTerm(
        name=name,
        function=function,
        scale=scale,
        clip=limits or (-math.inf, math.inf),
        history=min(max(int(steps or 0), 1), 100),
        flat_history=flat if isinstance(flat, bool) else None,
        width=len(scale) if scale and len(scale) > 1 else None,
        every=int(skipped) if 1 <= skipped <= 50 else None,
        form=f"order: oldest_first, by: {'step' if by_step else 'term'}",
        keys=f"frequency: {1 / period:g}" if period and "phase" in name else "",
    )


def read_descriptors(data: Data, _: RobotSpec, __: Sequence[Data]) -> ExporterMetadata:
    """Read what Isaac Lab exports with `export_io_descriptors`."""
    actions = cast("list[Any]", data["actions"]) if isinstance(data["actions"], list) else []
    action = fields_of(actions[0] if actions else None)
    names = action.texts("joint_names")
    robot = fields_of(next(iter(data.below("articulations").values()), {}))
    theirs = robot.texts("joint_names")
    scene = data.below("scene")

    def per_joint(key: str) -> tuple[float, ...]:
        values = robot.numbers(key)
        return reordered(values, theirs, names) if any(values) else ()

    kind = action_kind(str(action.get("full_path")), action.numbers("offset"))
    base = action.numbers("offset") or per_joint("default_joint_pos")
    clip, clip_notes = raw_limits(action, names, action.numbers("scale") or (1.0,), base)
    groups = data.below("observations")
    group = groups.get("policy", groups.get("actor", next(iter(groups.values()), [])))
    terms = cast("list[Any]", group) if isinstance(group, list) else []
    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=per_joint("default_joint_stiffness"),
        joint_damping=per_joint("default_joint_damping"),
        default_joint_pos=per_joint("default_joint_pos"),
        armature=per_joint("default_joint_armature"),
        action=kind,
        action_scale=action.numbers("scale"),
        action_clip=clip,
        rate=scene.per_second("dt"),
        physics_rate=scene.per_second("physics_dt"),
        observation_terms=tuple(_described_term(fields_of(term), names) for term in terms),
        notes=(
            *action_notes(
                str(action.get("full_path")),
                action.numbers("offset"),
                per_joint("default_joint_pos"),
            ),
            *(f"several terms make its action: {len(actions)}" for _ in actions[1:2]),
            *clip_notes,
        ),
    )


def _places(theirs: Sequence[str], names: Sequence[str]) -> tuple[int, ...]:
    """Return where the joints of a term stand among those of the action; empty where alike."""
    one, other = [*map(short_name, theirs)], [*map(short_name, names)]
    if one == other or sorted(one) != sorted(other):
        return ()
    return tuple(other.index(name) for name in one)


def _is_of_joints(term: ExportedTerm) -> bool:
    known = TERM_OF.get(term.function) or TERM_OF.get(term.name)
    return known is not None and known[0] in {"joint_pos", "joint_vel"}


def _described_term(term: Data, names: Sequence[str]) -> ExportedTerm:
    sizes = term.numbers("shape")
    read = manager_term(
        str(term.get("name")),
        term.below("overloads"),
        function=str(term.get("full_path")).rpartition(".")[2],
    )
    places = _places(term.texts("joint_names"), names)
    return replace(read, width=int(math.prod(sizes)) if sizes else None, select=places)


def read_environment(data: Data, robot: RobotSpec, _: Sequence[Data]) -> ExporterMetadata:
    """Read the environment of a training in Isaac Lab, or in mjlab, where patterns name joints."""
    scene = data.below("scene")
    asset = fields_of(scene.get("robot") or scene.below("entities").get("robot"))
    action = next(
        (fields_of(term) for term in data.below("actions").values() if "scale" in fields_of(term)),
        Fields(),
    )
    groups = data.below("observations")
    group = fields_of(groups.get("policy", groups.get("actor", next(iter(groups.values()), {}))))
    steps = group.number("history_length")
    terms: list[ExportedTerm] = []
    notes: list[str] = []
    commands = data.below("commands")
    motions = [name for name in commands if "anchor_body_name" in commands.below(name)]
    motion = commands.below(motions[0]) if motions else Fields()
    action_names, is_guess = _joint_order(action, robot)
    # A listed order is the action's alone: other terms are in the simulator's.
    is_listed = not is_guess and "isaaclab" in str(action.get("class_type"))
    simulators = isaac_lab_order(robot) if is_listed else ()
    for name, words in group.items():
        term = fields_of(words)
        if "func" in term:
            function = re.split(r"[.:]", str(term["func"]))[-1]
            asset_cfg = term.below("params").below("asset_cfg")
            theirs = simulators
            if asset_cfg.get("preserve_order") is True and "joint_names" in asset_cfg:
                listed_joints, theirs = asset_cfg["joint_names"], asset_cfg.texts("joint_names")
                if listed_joints != action.get("joint_names") and not _places(theirs, action_names):
                    notes.append(f"{name} lists joints in an order of its own: {listed_joints}")
            command = str(term.below("params").get("command_name"))
            if function == "generated_commands" and command in motions:
                function = MOTION_COMMAND
            described = manager_term(name, term, function=function, steps=steps)
            grid, other = _grid_of(scene, term.below("params"))
            notes += [f"{name} has what a card's scan has not: {each}" for each in other]
            width = described.width if grid is None else grid.x[2] * grid.y[2]
            places = _places(theirs, action_names) if _is_of_joints(described) else ()
            terms.append(replace(described, grid=grid, width=width, select=places))
    # Isaac Lab names groups of motors; mjlab lists them.
    inner = asset.below("articulation")
    listed = (inner if "actuators" in inner else asset).get("actuators")
    groups_of_motors = [
        fields_of(motor)
        for motor in (listed if isinstance(listed, list) else fields_of(listed).values())
    ]
    names = _with_motors(action_names, groups_of_motors)
    patterns = Patterns(names)
    simulation = data.below("sim")
    step = simulation.number("dt") or simulation.below("mujoco").number("timestep")
    motors, motor_notes = motor_groups(groups_of_motors, patterns, physics_rate=per_second(step))
    every = data.number("decimation")
    state = asset.below("init_state")
    own = (
        () if action.get("use_default_offset") is not False else action.numbers("offset") or (0.0,)
    )
    kind = str(action.get("class_type"))
    pose, scale = (
        patterns.values(state, "joint_pos", default=0.0),
        patterns.values(action, "scale"),
    )
    is_torque = action_kind(kind, own) == "joint_torque"
    clip, clip_notes = raw_limits(action, names, scale, () if is_torque else own or pose)
    known = any(groups_of_motors) or "joint_pos" in state
    return ExporterMetadata(
        joint_names=names if known else (),
        joint_stiffness=patterns.motors(groups_of_motors, "stiffness"),
        joint_damping=patterns.motors(groups_of_motors, "damping"),
        default_joint_pos=pose,
        torque_limits=patterns.motors(with_limits(groups_of_motors), "effort_limit"),
        armature=patterns.motors(groups_of_motors, "armature"),
        friction_loss=_friction(patterns, groups_of_motors),
        viscous_friction=patterns.motors(groups_of_motors, "viscous_friction", default=0.0),
        motors=motors,
        action=action_kind(kind, own),
        action_scale=scale,
        action_clip=clip,
        rate=per_second(step * every if step and every else None),
        physics_rate=per_second(step),
        speeds=speeds_of(data.get("commands")),
        observation_terms=tuple(terms),
        anchor=str(motion.get("anchor_body_name") or ""),
        bodies=motion.texts("body_names"),
        motion_file=str(motion.get("motion_file") or ""),
        guessed_order=is_guess and known,
        notes=(*action_notes(kind, own, pose), *notes, *motor_notes, *clip_notes),
    )


_SCAN_REACH = 10.0
"""m, of a grid from the root and of its offset: more is not a scan of the ground at a robot."""


def _grid_of(scene: Data, params: Data) -> tuple[HeightGrid | None, list[str]]:
    """Return the grid of a term's sensor, of Isaac Lab or of mjlab, and what a card's cannot be.

    Points are those of `torch.arange(-size / 2, size / 2 + 1e-9, resolution)` on both axes. They
    vary fastest along x where the pattern's `ordering` is `xy`, as it is by default.
    """
    name = params.below("sensor_cfg").get("name") or params.get("sensor_name")
    sensors = cast("list[Any]", listed) if isinstance(listed := scene.get("sensors"), list) else []
    sensor = next((found for found in map(fields_of, sensors) if found.get("name") == name), None)
    is_isaac = sensor is None
    if sensor is None:
        sensor = fields_of(scene.get(str(name)))
    pattern = sensor.below("pattern_cfg" if is_isaac else "pattern")
    size, step = pattern.numbers("size"), pattern.number("resolution")
    if len(size) != 2 or not step or min(size) < 0.0 or step < 0.0 or max(size) / step > 500:
        return None, []
    mounted = sensor.below("offset")
    usual: list[tuple[str, Any, tuple[Any, ...]]] = [
        ("rays that turn as", sensor.get("ray_alignment", True), ("yaw", True)),
        ("attach_yaw_only", sensor.get("attach_yaw_only", True), (True,)),
        ("ordering", pattern.get("ordering", "xy"), ("xy", "yx")),
        ("direction", pattern.get("direction", [0, 0, -1]), ([0, 0, -1],)),
        ("rot", mounted.get("rot", [1, 0, 0, 0]), ([1, 0, 0, 0],)),
    ]
    other = [f"{what} {value!r}" for what, value, known in usual if value not in known]
    at, own = (
        mounted.numbers("pos") if "pos" in mounted else (0.0, 0.0, 0.0),
        params.number("offset"),
    )
    # `height_scan` of Isaac Lab takes off 0.5 m unless told otherwise; mjlab's nothing.
    offset = (0.5 if is_isaac else 0.0) if own is None else own
    if len(at) != 3 or max(*size, *map(abs, at[:2]), abs(offset)) > _SCAN_REACH:
        return None, [*other, f"pos {list(at)}, size {list(size)}, offset {offset:g}"]
    axes: list[tuple[float, float, int]] = []
    for length, centre in zip(size, at, strict=False):
        count = int(length / step + 1e-6) + 1
        first = centre - length / 2
        axes.append((round(first, 6), round(first + step * (count - 1), 6), count))
    path = sensor.get("prim_path")
    grid = HeightGrid(
        x=axes[0],
        y=axes[1],
        order="y_fastest" if pattern.get("ordering") == "yx" else "x_fastest",
        offset=-offset,
        body=path.rpartition("/")[2] if isinstance(path, str) else "",
    )
    return grid, other


def read_direct_environment(data: Data, robot: RobotSpec, _: Sequence[Data]) -> ExporterMetadata:
    """Read an environment of Isaac Lab that computes its observations in code of its own.

    The file says everything but what the policy sees.
    """
    asset = data.below("robot")
    names, is_guess = _joint_order(Fields({"class_type": "isaaclab"}), robot)
    groups = [fields_of(motor) for motor in asset.below("actuators").values()]
    names = _with_motors(names, groups)
    patterns = Patterns(names)
    step, every = data.below("sim").number("dt"), data.number("decimation")
    motors, motor_notes = motor_groups(groups, patterns, physics_rate=per_second(step))
    return ExporterMetadata(
        joint_names=names,
        joint_stiffness=patterns.motors(groups, "stiffness"),
        joint_damping=patterns.motors(groups, "damping"),
        default_joint_pos=patterns.values(asset.below("init_state"), "joint_pos", default=0.0),
        torque_limits=patterns.motors(with_limits(groups), "effort_limit"),
        armature=patterns.motors(groups, "armature"),
        friction_loss=_friction(patterns, groups),
        viscous_friction=patterns.motors(groups, "viscous_friction", default=0.0),
        motors=motors,
        action="joint_position_offset",
        action_scale=data.numbers("action_scale"),
        rate=per_second(step * every if step and every else None),
        physics_rate=per_second(step),
        guessed_order=is_guess,
        notes=(
            IN_CODE,
            *motor_notes,
        ),
    )


def _friction(patterns: Patterns, groups: Sequence[Data]) -> tuple[float, ...]:
    """Return the friction of joints where it is a torque, N m: in mjlab, and with Isaac Sim 5."""
    newtons = [g for g in groups if {"dynamic_friction", "viscous_friction"} & set(g)]
    return patterns.motors(groups, "frictionloss", default=0.0) or patterns.motors(
        newtons, "friction", default=0.0
    )


def _with_motors(names: tuple[str, ...], groups: Sequence[Data]) -> tuple[str, ...]:
    """Return the joints that a motor drives; all where that is none of them.

    A training of some joints has a model without the others, and no motors for these.
    """
    by_group = [Patterns(names).names_of(group) for group in groups]
    if not all(by_group):  # Patterns of a group are not understood.
        return names
    return tuple(name for name in names if any(name in own for own in by_group)) or names


def _joint_order(action: Data, robot: RobotSpec) -> tuple[tuple[str, ...], bool]:
    """Return the joints of the action, and whether their order is a guess."""
    own = [short_name(joint) for joint in robot.joints]
    listed = [short_name(name) for name in action.texts("joint_names")]
    if sorted(listed) == sorted(own) and action.get("preserve_order") is True:
        return tuple(listed), False
    is_lab = "isaaclab" in str(action.get("class_type"))
    return (isaac_lab_order(robot) if is_lab else tuple(own)), True


def read_agent(data: Data, _: RobotSpec, __: Sequence[Data]) -> ExporterMetadata:
    """Read the trainer's own settings: rsl_rl, skrl or rl_games."""
    policy, config = data.below("models").below("policy"), data.below("params").below("config")
    policy.doubt("output", policy.get("output"), readable=policy.get("output") == "ACTIONS")
    notes = ("params.config.clip_actions is false: rl_games clips no actions then",)
    return ExporterMetadata(
        activation=activation_of(data),
        action_clip=data.limits("clip_actions"),
        notes=notes if config.get("clip_actions") is False else (),
    )


def activation_of(data: Data) -> str:
    """Return what is between the layers of a network; empty where a trainer's file has none."""
    for path in (
        ("actor", "activation"),
        ("policy", "activation"),
        ("models", "policy", "network", "activations"),
        ("params", "network", "mlp", "activation"),
    ):
        value: Any = data
        for key in path:
            if isinstance(value, list) and value:
                value = cast("list[Any]", value)[0]
            value = fields_of(value).get(key)
        if isinstance(value, list) and value:
            value = cast("list[Any]", value)[0]
        if isinstance(value, str):
            return value.rpartition(".")[2].lower()
    return ""
