"""What the exporters of policies write into ONNX files, and a policy as files describe it.

The exporters of mjlab and Isaac Lab write metadata into ONNX files. Lists are joined by commas,
numbers with three decimals; a scalar is written as it is. An entry of a list that is a list itself
is joined by semicolons: mjlab writes a clip as `-100.000;100.000`, and a scale for each number of a
term as `0.500;0.250`. Brackets and quotes, which some forks add, are taken off.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

from nw_policies.drafting.fields import Fields, account
from nw_policies.drafting.notation import plain

_NUMBERS = ("joint_stiffness", "joint_damping", "default_joint_pos", "action_scale")
_NAMES = ("joint_names", "observation_names")
_LONGEST = 10_000  # Characters of a list of terms; splitting takes the square of them.


@dataclass(frozen=True, kw_only=True)
class HeightGrid:
    """The grid that a scan of heights is measured on, as a training's configuration has it."""

    x: tuple[float, float, int]
    """First, last and number of points ahead of the trunk, m."""
    y: tuple[float, float, int]
    """The same to the left, m."""
    order: str
    """`x_fastest` or `y_fastest`, as a card writes it."""
    offset: float
    """Added to the trunk's height over the ground, m."""
    body: str
    """Whose height counts."""


@dataclass(frozen=True, kw_only=True)
class ExportedTerm:
    """A term of the observation; None where the file does not say, or cannot be read."""

    name: str
    scale: tuple[float, ...] | None = None
    """Factor after clipping: one for all numbers of the term, or one each."""
    clip: tuple[float, float] | None = None
    """Limits before scaling; infinite where a side has none."""
    history: int | None = None
    """Frames, the present one included: at least 1."""
    flat_history: bool | None = None
    """Whether its frames are one row of numbers, oldest first."""
    function: str = ""
    """What computes it, where the file names that apart from the term."""
    width: int | None = None
    """Numbers of one frame."""
    form: str = "order: oldest_first, by: term"
    """How its frames stand in the row, as a card writes it."""
    keys: str = ""
    """Further keys of the term on a card, such as a clock's frequency."""
    grid: HeightGrid | None = None
    """Of a scan of heights."""
    every: int | None = None
    """Actions from one frame of an image to the next."""
    own: str = ""
    """Its term on a card, where the reader of the file knows it with `width` and `keys`."""
    select: tuple[int, ...] = ()
    """Places of its joints in the action's order, where its own is another."""
    keeps_one: bool = False
    """Whether a history of one frame is a history: the frame is not the present one."""

    @property
    def word(self) -> str:
        """What tells which term of a card it is."""
        return self.function or self.name


@dataclass(frozen=True, kw_only=True)
class ExporterMetadata:
    """What the exporter knew; empty where the file does not say."""

    joint_names: tuple[str, ...] = ()
    joint_stiffness: tuple[float, ...] = ()
    """N m/rad, in the order of `joint_names`, as all lists of numbers here."""
    joint_damping: tuple[float, ...] = ()
    """N m s/rad."""
    default_joint_pos: tuple[float, ...] = ()
    """rad."""
    action_scale: tuple[float, ...] = ()
    """rad for each unit of action; one number for all joints, or one each."""
    observation_terms: tuple[ExportedTerm, ...] = ()
    """In the order in which they are joined."""
    observation_clip: float | None = None
    """Limit of all observations, after scaling."""
    action: str = ""
    """What an action means, as a card writes it; a position offset where nothing is said."""
    action_clip: tuple[float, float] | None = None
    """Limits of raw actions."""
    torque_limits: tuple[float, ...] = ()
    """N m."""
    armature: tuple[float, ...] = ()
    """kg m^2."""
    friction_loss: tuple[float, ...] = ()
    """N m."""
    viscous_friction: tuple[float, ...] = ()
    """N m s/rad."""
    motors: tuple[Mapping[str, Any], ...] = ()
    """Groups of motors that were more than servos, by the keys of a card."""
    rate: float | None = None
    """Actions per second."""
    physics_rate: float | None = None
    """Physics steps per second of the training."""
    speeds: Mapping[str, tuple[float, float]] = field(
        default_factory=dict[str, tuple[float, float]]
    )
    """Ranges of the commanded velocities, by lin_vel_x, lin_vel_y (m/s) and ang_vel_z (rad/s)."""
    anchor: str = ""
    """The body by which the policy sees the motion that it tracks."""
    bodies: tuple[str, ...] = ()
    """The bodies that are compared with those of the motion."""
    motion_file: str = ""
    """Of the training."""
    motion_joints: tuple[str, ...] = ()
    """Joints of that file, where they are not all of the robot's."""
    commanded: tuple[str, ...] = ()
    """Joints that the policy drives from an angle which a command moves."""
    activation: str = ""
    """Between the layers of the network."""
    model: str = ""
    """Name of the checkpoint that the file is about."""
    joint_count: int = 0
    """Joints of the robot that it is about; 0 where nothing says it."""
    input_size: int = 0
    """Numbers of a frame that the policy takes; 0 where nothing says it."""
    guessed_order: bool = False
    """Whether `joint_names` are in an order that the file does not say."""
    notes: tuple[str, ...] = ()
    """Sentences that the author of the card must read."""
    sources: Mapping[str, str] = field(default_factory=dict[str, str])
    """Which file a field is from; those that are missing here are from the checkpoint."""


def read_exporter_metadata(entries: Mapping[str, str], size: int = 0) -> ExporterMetadata | None:
    """Return the metadata of a file, or None if it has none.

    What cannot be read, or is of no known exporter, is left out and named in a note.

    Args:
        entries: of the file.
        size: numbers that it takes.
    """
    if "exploy_version" in entries:
        return _exploy(entries)
    if {"dof_names", "kp", "kd"} <= entries.keys():
        return _holosoma(entries, size - 1)
    if not entries:
        return None
    text = {name: entries.get(name, "") for name in (*_NUMBERS, *_NAMES)}
    terms = _names(text["observation_names"])
    columns = {f"observation_terms_{key}" for key in _COLUMNS if terms}
    columns |= {f"observation_term_{key}" for key in _COLUMNS if terms}
    notes = [
        f"{name} in its metadata cannot be read: {plain(text[name])[:80]}"
        for name in _NUMBERS
        if text[name].strip() and not _numbers(text[name])
    ]
    notes += [
        f"{name} in its metadata has not one entry for each of {len(terms)} terms"
        for name in sorted(columns & set(entries))
        if not any(_entries(entries[name], len(terms)))
    ]
    return ExporterMetadata(
        # mjlab names joints behind the entity that has them: robot/FL_hip_joint.
        joint_names=tuple(name.rpartition("/")[2] for name in _names(text["joint_names"])),
        joint_stiffness=_numbers(text["joint_stiffness"]),
        joint_damping=_numbers(text["joint_damping"]),
        default_joint_pos=_numbers(text["default_joint_pos"]),
        action_scale=_numbers(text["action_scale"]),
        observation_terms=_exported_terms(terms, entries),
        anchor=entries.get("anchor_body_name", "").strip(),
        bodies=_names(entries.get("body_names", "")),
        notes=(*notes, *_unread(entries, {*_NUMBERS, *_NAMES, *_OF_MOTION, *columns})),
    )


_OF_HOLOSOMA = ("actions", "base_ang_vel", "dof_pos", "dof_vel")
_MOTION_OF_HOLOSOMA = ("motion_command", "motion_ref_ori_b")
_HOLOSOMA_POSE = {
    "_hip_pitch": -0.312, "_knee": 0.669, "_ankle_pitch": -0.363, "_elbow": 0.6,
    "_shoulder_pitch": 0.2, "left_shoulder_roll": 0.2, "right_shoulder_roll": -0.2,
}  # fmt: skip
"""rad, of the G1 that holosoma trains, by parts of names; the others are 0."""


def _walk_of_holosoma(term: ExportedTerm) -> tuple[ExportedTerm, ...]:
    """Return what a G1 of holosoma sees that is commanded a velocity, in the order of the names."""
    feet = "frequency: 1, offsets: [0, 0.5], standing: {below: 0.01, phase: 0.5}, values"

    def of(name: str, own: str = "", width: int = 0, keys: str = "", scale: float = 1.0) -> Any:
        return replace(term, name=name, own=own, width=width or None, keys=keys, scale=(scale,))

    return (
        of("actions"),
        of("base_ang_vel", scale=0.25),
        of("command_ang_vel", "command", 1, "parts: [yaw]"),
        of("command_lin_vel", "command", 2, "parts: [vx, vy]"),
        of("cos_phase", "clock", 2, f"{feet}: [cosine]"),
        of("dof_pos"),
        of("dof_vel", scale=0.05),
        of("projected_gravity"),
        of("sin_phase", "clock", 2, f"{feet}: [sine]"),
    )


def _holosoma(entries: Mapping[str, str], size: int) -> ExporterMetadata:
    """Return the metadata of holosoma, which are JSON.

    The file names no terms, pose or unit of action: they are those of `holosoma_inference` for a
    policy that tracks a motion without knowing where it is, or that a G1 walks with.

    Args:
        entries: of the file.
        size: numbers that it takes, beside the number of the frame.
    """

    def listed(name: str) -> list[Any]:
        try:
            value = json.loads(entries[name])
        except (ValueError, RecursionError):
            return []
        return cast("list[Any]", value) if isinstance(value, list) else []

    joints = tuple(map(str, listed("dof_names")))
    is_tracker = size == 5 * len(joints) + 9
    is_walk = size == 3 * len(joints) + 12 and any("waist_pitch" in name for name in joints)
    names = (*_OF_HOLOSOMA, *_MOTION_OF_HOLOSOMA)
    pose = [next((v for k, v in _HOLOSOMA_POSE.items() if k in name), 0.0) for name in joints]
    term = ExportedTerm(name="", scale=(1.0,), clip=(-math.inf, math.inf), history=1)
    gains = {name: [x for x in listed(name) if isinstance(x, int | float)] for name in ("kp", "kd")}
    return ExporterMetadata(
        joint_names=joints,
        joint_stiffness=tuple(gains["kp"]),
        joint_damping=tuple(gains["kd"]),
        default_joint_pos=tuple(pose) if is_walk else (),
        action_scale=(1.0,) if is_tracker else (0.25,) if is_walk else (),
        rate=50.0 if is_walk else None,
        observation_terms=tuple(replace(term, name=name) for name in names)
        if is_tracker
        else _walk_of_holosoma(term)
        if is_walk
        else (),
        notes=("its terms, scales, pose and rate are those of holosoma's own G1",) * is_walk
        + _unread(entries, {"dof_names", "kp", "kd", "robot_urdf", "robot_urdf_path"}),
    )


_OF_MOTION = ("anchor_body_name", "body_names")
_COLUMNS = ("scale", "clip", "history_length", "flatten_history_dim")
_NO_EFFECT = frozenset({"run_path", "producer", "pytorch_version", "exploy_version", "author"})
"""Entries of metadata that say where a file is from."""
_VELOCITIES = frozenset({"", "motion", "twist", "base_velocity", "velocity", "velocity_commands"})


def _unread(entries: Mapping[str, str], read: Collection[str]) -> tuple[str, ...]:
    """Return the note that names the entries of metadata which nothing reads."""
    commands = entries.get("command_names", "").strip("[]'\" ")
    read = {*read, *_NO_EFFECT, *(["command_names"] if commands in _VELOCITIES else [])}
    left = [plain(name) for name in entries if name not in read]
    return (f"its metadata has what this card does not: {', '.join(left)}",) if left else ()


def _exploy(entries: Mapping[str, str]) -> ExporterMetadata:
    """Return the metadata that exploy writes: JSON, by the names of inputs and outputs.

    Its graphs compute observations themselves, so no terms are named.
    """
    read = {"update_rate"}

    def first(prefix: str) -> Fields:
        for name, text in entries.items():
            if name.startswith(prefix):
                try:
                    value = json.loads(text)
                except (ValueError, RecursionError):
                    continue
                if isinstance(value, dict):
                    read.add(name)
                    return Fields(cast("dict[str, Any]", value))
        return Fields()

    targets, command = first("output.joint_targets."), first("cmd.se2_velocity.")
    ranges = command.below("ranges")
    limits = {key: ranges.numbers(key) for key in ("lin_vel_x", "lin_vel_y", "ang_vel_z")}
    rate = _numbers(entries.get("update_rate", ""))
    return ExporterMetadata(
        joint_names=targets.texts("names"),
        joint_stiffness=targets.numbers("stiffness"),
        joint_damping=targets.numbers("damping"),
        rate=rate[0] if rate else None,
        speeds={key: (v[0], v[1]) for key, v in limits.items() if len(v) == 2 and v[0] < v[1]},
        notes=(
            *account("output.joint_targets", (), targets),
            *account("cmd.se2_velocity", (), command),
            *_unread(entries, read),
        ),
    )


def _exported_terms(names: Sequence[str], entries: Mapping[str, str]) -> tuple[ExportedTerm, ...]:
    def column(key: str) -> Sequence[str | None]:
        text = entries.get(f"observation_terms_{key}", entries.get(f"observation_term_{key}", ""))
        return _entries(text, len(names))

    columns = zip(
        names,
        *map(column, _COLUMNS),
        strict=True,
    )
    # What a tracking policy is commanded is its motion.
    is_motion = entries.get("command_names", "").strip("[]'\" ") == "motion"
    return tuple(
        ExportedTerm(
            name=name,
            function="motion_command" if is_motion and name == "command" else "",
            scale=_scale(scale),
            clip=_clip(clip),
            history=_history(history),
            flat_history=_flag(flat),
        )
        for name, scale, clip, history, flat in columns
    )


def _entries(text: str, count: int) -> Sequence[str | None]:
    """Return the entries of a list, one for each term; of another length it says nothing."""
    if len(text) > _LONGEST:
        return [None] * count
    for whole in (text, text.strip()[1:-1]):
        entries = [entry.strip() for entry in re.split(r",(?![^\[(]*[\])])", whole)]
        # A bracket that opens in one entry and closes in another is that of the whole list.
        closed = all(len(re.findall(r"[\[(]", e)) == len(re.findall(r"[\])]", e)) for e in entries)
        if closed and len(entries) == count and text.strip():
            return entries
    return [None] * count


def _parts(entry: str | None) -> tuple[float, ...] | None:
    try:
        return tuple(float(part) for part in re.split(r"[;,\s]+", (entry or "").strip("[]() ")))
    except ValueError:
        return None


def _is_none(entry: str | None) -> bool:
    return (entry or "").lower() in {"none", "null"}


def _scale(entry: str | None) -> tuple[float, ...] | None:
    numbers = (1.0,) if _is_none(entry) else _parts(entry)
    return numbers if numbers and all(math.isfinite(number) for number in numbers) else None


def _clip(entry: str | None) -> tuple[float, float] | None:
    numbers = (-math.inf, math.inf) if _is_none(entry) else _parts(entry)
    # NaN fails the comparison too.
    return numbers if numbers and len(numbers) == 2 and numbers[0] < numbers[1] else None


def _history(entry: str | None) -> int | None:
    numbers = (0.0,) if _is_none(entry) else _parts(entry)
    if not numbers or len(numbers) != 1 or numbers[0] not in range(101):
        return None
    return max(int(numbers[0]), 1)  # Both exporters write 0 for a term without history.


def _flag(entry: str | None) -> bool | None:
    return {"true": True, "false": False, "1": True, "0": False}.get(
        re.sub(r"\.0*$", "", (entry or "").lower())
    )


def _names(text: str) -> tuple[str, ...]:
    parts = (plain(part) for part in text.strip().strip("[]()").split(","))
    return tuple(item for item in (part.strip("'\"") for part in parts) if item)


def _numbers(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(item) for item in _names(text))
    except ValueError:
        return ()
    return numbers if all(math.isfinite(number) for number in numbers) else ()
