"""Facts that a checkpoint of any known format contains, read without running it.

A graph says what it takes and gives. Of a scripted module, TorchScript keeps the code in members
`code/__torch__/...py`, in a small language that always writes a method as `def forward(self:
Type,`, one line for each argument, `) -> Type:`; it is read as text, nothing of it is run or
compiled.

The exporters of mjlab and Isaac Lab write metadata into ONNX files. Lists are joined by commas,
numbers with three decimals; a scalar is written as it is. An entry of a list that is a list itself
is joined by semicolons: mjlab writes a clip as `-100.000;100.000`, and a scale for each number of a
term as `0.500;0.250`. Brackets and quotes, which some forks add, are taken off.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, assert_never, cast

from nw_base.clean import clean
from nw_base.errors import PolicyError
from nw_base.files.inside import regular
from nw_policies.drafting.fields import Fields, account
from nw_policies.drafting.notation import plain
from nw_policies.networks.onnx_graph import state_pairs
from nw_policies.safety import (
    FileKind,
    FileLimits,
    TensorFacts,
    check_onnx,
    file_kind,
    open_archive,
    tensor_facts,
)
from nw_policies.safety.objects import Record, read_objects
from nw_policies.safety.tensors import plain_entries

EXPORT = "export the policy as ONNX or with torch.export"
_STATE_DICTS = "a plain state dict is enough for layers in a row, extreme-parkour, LucidSim and ACT"

_NUMBERS = ("joint_stiffness", "joint_damping", "default_joint_pos", "action_scale")
_NAMES = ("joint_names", "observation_names")
_LONGEST = 10_000  # Characters of a list of terms; splitting takes the square of them.
_CODE_BYTES = 2**20
_FOLLOWED = 8
"""Functions that an argument is followed through to its first layer."""
_KEEP_WIDTH = "clamp|clip|sub|add|mul|div|to|unsqueeze|squeeze|nan_to_num|contiguous|clone|tanh"
_NOWHERE = "\0"
_ARGUMENT = re.compile(r"^(\w+): ([\w.\[\], ]+?)(?:\s*=.*)?$")


@dataclass(frozen=True, kw_only=True)
class ArrayFacts:
    """An input or output of a graph."""

    name: str
    shape: tuple[int | None, ...]
    """None is a free axis."""
    dtype: str


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


@dataclass(frozen=True, kw_only=True)
class ScriptInput:
    """An argument of a module's `forward` that has no default."""

    name: str
    kind: str
    """`Tensor`, or another type as TorchScript writes it."""
    size: int | None
    """How many numbers the layer takes that it is passed to; None where other code sees it first.
    """
    images: tuple[int | None, ...] = ()
    """Of a list of tensors: for each that is used, the channels of the convolution it goes into."""


@dataclass(frozen=True, kw_only=True)
class CheckpointFacts:
    """Facts that a checkpoint contains."""

    path: Path
    sha256: str
    format: FileKind
    adapter: str | None
    """The adapter of a card that reads it; None if the file holds weights of an unknown network."""
    inputs: tuple[ArrayFacts, ...] = ()
    """What it takes at each step, without recurrent state; empty where the format does not say."""
    script: tuple[ScriptInput, ...] = ()
    """What the code of a TorchScript file says that it takes, without shapes."""
    taken: int = 0
    """Numbers of a row of zeros that its one input was seen to take; 0 where it was not run."""
    joints: int = 12
    """Of the robot that it drives, by which published layouts are found."""
    outputs: tuple[ArrayFacts, ...] = ()
    recurrent: tuple[str, ...] = ()
    """Names of the state that it carries from step to step."""
    parameters: int = 0
    """Numbers in its tensors; 0 where they were not counted."""
    tensors: tuple[TensorFacts, ...] = ()
    """Tensors by name, for formats that name them."""
    entries: tuple[str, ...] = ()
    """Names of what else a file of weights has: numbers, texts and lists of them."""
    metadata: Mapping[str, str] = field(default_factory=dict[str, str])
    """Entries that an exporter left in the file, as they are."""
    exporter: ExporterMetadata | None = None
    """The same, understood."""


def inspect_checkpoint(path: Path) -> CheckpointFacts:
    """Read a checkpoint without running it.

    Args:
        path: an ONNX, TorchScript, torch.export, safetensors or torch state-dict file, a zip file
            of Stable-Baselines3, or parameters of brax or flax.

    Raises:
        PolicyError: the file cannot be read, is none of these, or could run code.
    """
    where = str(path)
    try:
        size = regular(path).stat().st_size
        if size > FileLimits().file_bytes:
            raise PolicyError(
                f"{where}: the file has {size / 2**20:.0f} MiB, over the limit of "
                f"{FileLimits().file_bytes // 2**20}",
                fix="export the actor alone",
            )
        data = path.read_bytes()
    except OSError as error:
        raise PolicyError(
            f"{where}: the checkpoint cannot be read: {error.strerror}", fix="check the path"
        ) from None
    try:
        return _facts(data, path)
    except PolicyError as error:
        if error.fix is None or not re.search("state.dict", error.fix):
            raise
        # A state dict helps whoever has a card; here it would be refused as an unknown network.
        what = str(error).removesuffix(f"; {error.fix}")
        raise PolicyError(what, fix=f"{EXPORT} where you trust the file; {_STATE_DICTS}") from None


def _facts(data: bytes, path: Path) -> CheckpointFacts:
    where = str(path)
    sha256 = hashlib.sha256(data).hexdigest()
    kind = file_kind(data, where)
    match kind:
        case "onnx":
            return _onnx(data, path, sha256)
        case "torch-export":
            return _exported(data, path, sha256)
        case (
            "torchscript"
            | "state-dict"
            | "safetensors"
            | "stable-baselines3"
            | "pickle"
            | "msgpack"
        ):
            is_script = kind == "torchscript"
            tensors = tensor_facts(data, where)
            return CheckpointFacts(
                path=path,
                sha256=sha256,
                format=kind,
                adapter="torchscript" if is_script else _known_network(tensors),
                script=script_inputs(data, where, tensors) if is_script else (),
                recurrent=_recurrent_weights(tensors),
                parameters=sum(math.prod(tensor.shape) for tensor in tensors),
                tensors=tensors,
                entries=() if is_script else plain_entries(data, where),
                metadata=_SETTINGS[kind](data, where) if kind in _SETTINGS else {},
                exporter=_noted(data, where) if kind in {"safetensors", "torchscript"} else None,
            )
        case "unknown":
            raise PolicyError(
                f"{where}: the format of the file is unknown",
                fix="give an ONNX, TorchScript, torch.export or state-dict file",
            )
        case _:
            assert_never(kind)


_OF_NETWORK = re.compile(
    r":.*|__.*|activation_fn|squash_output|use_sde|net_arch|ortho_init|.*std.*|use_expln|"
    r"optimizer_.*|n_critics|n_quantiles|share_features_extractor|normalize_images|.*lstm.*"
)
"""Settings of its networks that are read, are seen in the tensors, or steer a training."""


def _saved_settings(data: bytes, where: str) -> dict[str, str]:
    """Return what Stable-Baselines3 wrote down, as JSON, beside its pickles.

    It is the activation, the limits of the action space, and names of what is unknown here.
    """
    text = open_archive(data, where).read("data", at_most=FileLimits().index_bytes)
    try:
        whole = json.loads(text)
    except (ValueError, RecursionError):
        return {"unread": "all of `data`, which is no JSON"}
    settings = cast("dict[str, Any]", whole) if isinstance(whole, dict) else {}
    kwargs, space = settings.get("policy_kwargs"), settings.get("action_space")
    network = cast("dict[str, Any]", kwargs) if isinstance(kwargs, dict) else {}
    limits = cast("dict[str, Any]", space) if isinstance(space, dict) else {}
    facts = {f"action_{side}": str(limits.get(side, "")) for side in ("low", "high")}
    facts["use_sde"] = str(settings.get("use_sde"))
    facts["squash_output"] = str(network.get("squash_output"))
    function = str(network.get("activation_fn", ""))
    named = re.fullmatch(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>", function)
    # The algorithm's own attributes steer a training; `predict` reads the policy and the spaces.
    unread = [f"policy_kwargs.{name}" for name in network if not _OF_NETWORK.fullmatch(name)]
    if named is not None:
        facts["activation"] = named[1]
    elif function:
        unread.append(f"policy_kwargs.activation_fn {function}")
    return {**facts, "unread": plain(", ".join(unread))}


def _header_settings(data: bytes, _: str) -> dict[str, str]:
    """Return the texts in the header of a safetensors file, which has been checked."""
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    metadata = header.get("__metadata__")
    items = cast("dict[str, Any]", metadata).items() if isinstance(metadata, dict) else ()
    return {key: value for key, value in items if isinstance(value, str)}


def _noted(data: bytes, where: str) -> ExporterMetadata | None:
    """Return notes of what a header or extra files say, which nothing reads."""
    if file_kind(data, where) == "safetensors":
        left = [
            name for name in _header_settings(data, where) if name not in {"activation", "format"}
        ]
        what = "its header has what this card does not"
    else:
        left = [name for name in open_archive(data, where).names() if name.startswith("extra/")]
        what = "its extra files were not read"
    note = f"{what}: {plain(', '.join(left))}"
    return ExporterMetadata(notes=(note,)) if left else None


_SETTINGS = {"stable-baselines3": _saved_settings, "safetensors": _header_settings}


def _onnx(data: bytes, path: Path, sha256: str) -> CheckpointFacts:
    from nw_policies.networks.onnx_reading import read_declared

    check_onnx(data, str(path))
    try:
        declared = read_declared(data)
    except ValueError as error:
        raise PolicyError(
            f"{path}: not a usable ONNX file: {clean(error, at_most=200)}",
            fix="export it again as one file with standard operators",
        ) from None
    inputs = tuple(ArrayFacts(**each._asdict()) for each in declared.inputs)
    outputs = tuple(ArrayFacts(**each._asdict()) for each in declared.outputs)
    metadata = declared.metadata
    state = state_pairs({a.name: a.shape for a in inputs}, {a.name: a.shape for a in outputs})
    return CheckpointFacts(
        path=path,
        sha256=sha256,
        format="onnx",
        adapter="onnx",
        inputs=tuple(array for array in inputs if array.name not in state),
        outputs=tuple(array for array in outputs if array.name not in state.values()),
        recurrent=tuple(f"{source} -> {target}" for source, target in state.items()),
        tensors=tuple(TensorFacts(name=name, shape=(), dtype="") for name in declared.weights),
        metadata=metadata,
        exporter=(
            _holosoma(metadata, sum(array.shape[-1] or 0 for array in inputs if array.shape) - 1)
            if {"dof_names", "kp", "kd"} <= metadata.keys()
            else read_exporter_metadata(metadata)
        ),
    )


def _exported(data: bytes, path: Path, sha256: str) -> CheckpointFacts:
    from nw_policies.networks.exported import ExportedGraph

    graph = ExportedGraph(data, str(path))
    return CheckpointFacts(
        path=path,
        sha256=sha256,
        format="torch-export",
        adapter="torch-export",
        inputs=tuple(
            ArrayFacts(
                name=spec.name, shape=spec.shape, dtype=str(spec.dtype).removeprefix("torch.")
            )
            for spec in graph.inputs
        ),
        outputs=tuple(
            ArrayFacts(name=name, shape=shape, dtype="float32")
            for name, shape in zip(graph.outputs, graph.output_shapes, strict=True)
        ),
        recurrent=tuple(graph.state()),
        parameters=graph.parameters,
    )


def _recurrent_weights(tensors: Sequence[TensorFacts]) -> tuple[str, ...]:
    """Return the names of recurrent layers, whose hidden state the file does not show."""
    names = (tensor.name.rpartition(".") for tensor in tensors)
    return tuple(dict.fromkeys(path for path, _, leaf in names if leaf.startswith("weight_hh_l")))


def _known_network(tensors: Sequence[TensorFacts]) -> str | None:
    names = {tensor.name.removeprefix("model.") for tensor in tensors}
    if {"act_tokens", "transformer.0.fused_attn_ff_proj.weight"} <= names:
        return "lucidsim"
    if "estimator_state_dict.estimator.0.weight" in names:
        return "extreme-parkour"
    if {"decoder_pos_embed.weight", "action_head.weight"} <= names:
        return "act"
    return None


def read_exporter_metadata(entries: Mapping[str, str]) -> ExporterMetadata | None:
    """Return the metadata of a file, or None if it has none.

    What cannot be read, or is of neither exporter, is left out and named in a note.
    """
    if "exploy_version" in entries:
        return _exploy(entries)
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


def script_inputs(
    data: bytes, where: str, tensors: Sequence[TensorFacts]
) -> tuple[ScriptInput, ...]:
    """Return what `forward` takes; empty where the code does not say it plainly.

    Args:
        data: a whole TorchScript file.
        where: its path, for errors.
        tensors: the file's, for sizes.
    """
    body = forward_code(data, where)
    signature = re.match(r"  def forward\(\w+: [\w.]+(?:,\s*([^)]*))?\) ->", body)
    if signature is None or signature[1] is None:
        return ()
    inputs: list[ScriptInput] = []
    for argument in re.split(r",\s*\n\s*", signature[1].strip()):
        parts = _ARGUMENT.match(argument)
        if parts is None:
            return ()
        if "=" not in argument:
            size = _first_width(parts[1], body, tensors)
            images = _image_channels(parts[1], body, tensors) if parts[2] == "List[Tensor]" else ()
            inputs.append(ScriptInput(name=parts[1], kind=parts[2], size=size, images=images))
    return tuple(inputs)


def forward_code(data: bytes, where: str) -> str:
    """Return the lines of `forward` of a TorchScript file; "" where it does not show them."""
    archive = open_archive(data, where)
    index = archive.read("data.pkl", at_most=FileLimits().index_bytes)
    module = read_objects(index, where)
    if not isinstance(module, Record):
        return ""
    file, _, name = module.name.rpartition(".")
    try:
        code = archive.read(f"code/{file.replace('.', '/')}.py", at_most=_CODE_BYTES)
    except PolicyError:  # Absent or long: then it says nothing.
        return ""
    return _forward_code(code.decode("utf-8", "replace"), name)


def _forward_code(code: str, name: str) -> str:
    """Return the lines of `forward` of a class; "" if there is none."""
    start = code.find(f"class {name}(Module):\n")
    start = -1 if start < 0 else code.find("\n  def forward(", start) + 1
    # A later class may have one where this has none; both begin at the margin.
    if start < 1 or "\nclass " in code[code.find(f"class {name}(Module):\n") : start]:
        return ""
    end = re.search(r"\n(?=\S|  \S)", code[start:])
    return code[start : start + end.start()] if end else code[start:]


def _first_width(argument: str, body: str, tensors: Sequence[TensorFacts]) -> int | None:
    """Return the width of the first layer that an argument goes into, one function at a time."""
    for _ in range(_FOLLOWED):
        call = re.search(rf"(?:(\w+) = |\()\(?(\w+)\)\.forward\w*\({argument}, ", body)
        if call is not None:
            prefix = _submodule(call[2], body)
            layers = (t for t in tensors if prefix and t.name.startswith(prefix))
            size = next((tensor.shape[1] for tensor in layers if len(tensor.shape) == 2), None)
            if size is not None:
                return size
        else:
            call = re.search(rf"(\w+) = torch\.(?:{_KEEP_WIDTH})\({argument}[,)]", body)
        if call is None or call[1] is None:
            return None
        argument = call[1]
    return None


def _image_channels(
    argument: str, body: str, tensors: Sequence[TensorFacts]
) -> tuple[int | None, ...]:
    """Return the channels of the convolutions that the items of a list go into, by their place."""
    used = [int(place) for place in re.findall(rf"\b{argument}\[(\d{{1,2}})\]", body)]
    channels: list[int | None] = [None] * (max(used, default=-1) + 1)
    for call in re.finditer(rf"\((\w+)\)\.forward\w*\({argument}\[(\d{{1,2}})\], ", body):
        prefix = _submodule(call[1], body)
        layers = (t for t in tensors if prefix and t.name.startswith(prefix))
        channels[int(call[2])] = next((t.shape[1] for t in layers if len(t.shape) == 4), None)
    return tuple(channels)


def _submodule(name: str, body: str) -> str:
    """Return what the names of the tensors begin with of the submodule in a variable; or ""."""
    match = re.search(rf'\n    {name} = (?:(\w+)\.(\w+)|getattr\((\w+), "(\w+)"\))\n', body)
    if match is None:
        return ""
    of, own = match[1] or match[3], match[2] or match[4]
    return f"{own}." if of == "self" else f"{_submodule(of, body) or _NOWHERE}{own}."
