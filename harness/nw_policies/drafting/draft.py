"""A first card for a checkpoint, from the facts that it contains.

The card is valid YAML; its comments say what is known, what is a guess, and what its author must
check.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from nw_base.clean import clean
from nw_base.errors import PolicyError, nearest
from nw_policies.cards.control import MOST_PHYSICS_RATE, PHYSICS_RATE
from nw_policies.cards.joints import short_name
from nw_policies.drafting.beside import believed, read_beside, refuse_another_robot
from nw_policies.drafting.checkpoint import EXPORT, ArrayFacts, CheckpointFacts, inspect_checkpoint
from nw_policies.drafting.exporters import ExportedTerm, ExporterMetadata
from nw_policies.drafting.feeders import with_encoders
from nw_policies.drafting.inputs import (
    known_observations,
    parts_of,
    wanted_inputs,
    widths_to_try,
)
from nw_policies.drafting.layouts import Frame, is_scan, isaac_lab_order
from nw_policies.drafting.leapp import pipeline_of
from nw_policies.drafting.leapp_card import PipelineDraft, with_pipeline
from nw_policies.drafting.motors import motor_lines
from nw_policies.drafting.notation import (
    CHECK,
    in_brackets,
    number,
    one_or_list,
    plain,
    quoted,
    slug,
)
from nw_policies.drafting.some_joints import (
    commanded_lines,
    driven_joints,
    held_lines,
    known_of,
    known_of_all,
    of_joints,
)
from nw_policies.drafting.tracking import TABLES, reference_lines, tracks
from nw_policies.drafting.trained import (
    KNOWN_ACTIVATIONS,
    network_lines,
    normalised,
    trained_network,
)
from nw_policies.drafting.vectors import (
    Likely,
    ObservationDraft,
    likely_layouts,
    sized_terms,
    terms_for,
)
from nw_scenes.robots import BUILT_IN, RobotSpec, get_robot, know_robot

_ENOUGH_FEET, _TURNING_SPEED = 3, 0.3  # with which a robot stands; m/s ahead in turns
_ACTION = re.compile(r"action|\bmu\b|mean|joint|target", re.IGNORECASE)
_NAMELESS = re.compile(r"(policy|model)([._-].*)?", re.IGNORECASE)


def write_card_draft(
    facts: CheckpointFacts,
    robot: RobotSpec,
    folder: Path | None = None,
    layout: str | None = None,
    beside: Mapping[str, str] | None = None,
    statistics: Path | None = None,
    motions: Sequence[str] = (),
    feeders: Sequence[str] = (),
) -> str:
    """Return the text of a card, to be saved as policy.yaml beside the checkpoint.

    It is a valid card of the checkpoint's sizes. Lines with `CHECK:` are guesses or defaults. Other
    published layouts of these sizes stand at its end, as comments.

    Args:
        facts: from `inspect_checkpoint`.
        robot: the robot that the policy drives.
        folder: where the card will be saved; None = beside the checkpoint. A checkpoint outside of
            it gets a card for `--checkpoint`, and a comment that says so.
        layout: name of the published layout that the card is to have; None = the likeliest.
        beside: name and text of files beside the checkpoint, for facts that it lacks.
        statistics: the `VecNormalize` of Stable-Baselines3 that was saved with it.
        motions: files below the card's folder that may be the motion which it tracks.
        feeders: paths of other networks beside it, one of which may encode an image for it.

    Raises:
        PolicyError: the file holds weights of a network that is not known here, does not fit
            `layout`, or is of another robot; `statistics` cannot be read.
    """
    widths = [array.shape[-1] or 0 for array in facts.inputs if array.shape]
    widths = widths or [argument.size or 0 for argument in facts.script]
    size = (widths[0] if len(widths) == 1 else 0) or facts.taken
    known = read_beside(beside or {}, robot, str(facts.path), facts.exporter, size)
    pipeline = pipeline_of(beside or {}, facts.path.name)
    if pipeline is not None:
        known = with_pipeline(*pipeline, facts, known)
    whole, said, part = robot, known, driven_joints(facts, known, robot)
    if part:
        robot, known = of_joints(robot, part), known_of(known, part)
    refuse_another_robot(facts, known, robot)
    known = known and believed(known, robot)
    facts = replace(facts, exporter=known, joints=len(robot.joints))
    network = trained_network(facts, len(robot.joints)) if facts.adapter is None else None
    if network is not None:
        size = ArrayFacts(name="obs", shape=(1, network.layers[0].inputs), dtype="float32")
        facts = replace(facts, adapter="mlp", inputs=(size,))
        network = normalised(network, statistics)
    if facts.adapter is None:
        shown = ", ".join(f"{tensor.name} {tensor.shape}" for tensor in facts.tensors[:3])
        raise PolicyError(
            f"{facts.path}: weights of an unknown network: {shown}, ...",
            fix=f"{EXPORT}, which hold the network too; layers in a row with "
            f"{len(robot.joints)} outputs, one for each joint, would be run as they are",
        )
    notes = known.notes if known else ()
    if pipeline is None:
        body, parts = _body(facts, layout, robot, feeders)
    else:
        draft = PipelineDraft(*pipeline, facts, layout)
        body, parts, notes = draft.lines(folder), draft.parts, (*notes, *draft.notes)
        _refuse_unknown(layout, parts, facts.path)
        if draft.is_commanded:
            body = [_follower(known, robot), "", *body]
    frames = [each.fits[0][0] for each in parts if each.fits]
    of_all = known_of_all(said, facts.exporter, whole) if part else None
    # What one of them feeds back clipped, `control` must clip.
    frame = next((f for f in frames if f.clip is not None), frames[0] if frames else None)
    lines = [
        *_summary(facts),
        "nw-policy: 1",
        f"name: {quoted(_name(facts.path))}",
        'title: ""  # one line for people',
        f'licence: ""  {CHECK} under which terms may others run it?',
        *_trained_speeds(known),
        f"robot: {robot.name}",
        f"adapter: {facts.adapter}",
        *_checkpoint(facts, folder),
        *([] if network is None else network_lines(network, *_activation(facts))),
        *(f"{CHECK} {clean(note, at_most=_LONGEST_NOTE)}" for note in notes),
        "",
        *control_lines(
            of_all or facts.exporter,
            whole if of_all else robot,
            frame,
            clip=network.clip if network else None,
            folder=folder or facts.path.parent,
        ),
        *held_lines(part, whole, said),
        *commanded_lines(said),
        "",
        *body,
        *_reference(facts, robot, motions, folder),
        *other_layouts(parts, robot),
    ]
    return "\n".join(lines) + "\n"


def _reference(
    facts: CheckpointFacts, robot: RobotSpec, motions: Sequence[str], folder: Path | None
) -> list[str]:
    """Return the lines of the motion that the policy tracks; none where nothing speaks of one."""
    known = facts.exporter or ExporterMetadata()
    words = [
        word.rpartition("/")[2]
        for term in known.observation_terms
        for word in (term.name, term.function)
    ]
    if not tracks(facts, known, words):
        return []
    return ["", *reference_lines(facts, known, robot, motions, _file_below(facts, folder)[0])]


_LONGEST_NOTE = 10_000  # characters
_ACTIVATIONS = {"leakyrelu": "leaky_relu", "lrelu": "leaky_relu", "swish": "silu"}


def _activation(facts: CheckpointFacts) -> tuple[str, str]:
    """Return the activation of a training's network as a card calls it, and which file says so."""
    said, source = facts.metadata.get("activation", "").lower(), plain(facts.path.name)
    if not said and facts.exporter is not None:
        said, source = facts.exporter.activation, facts.exporter.sources.get("activation", "")
    said = _ACTIVATIONS.get(said, said)
    return (said, source) if said in KNOWN_ACTIVATIONS else ("", "")


def draft_of(
    *,
    checkpoint: str,
    robot: str,
    folder: str,
    robot_folder: str | None = None,
    layout: str | None = None,
    beside: Mapping[str, str] | None = None,
    statistics: str | None = None,
    motions: Sequence[str] = (),
    feeders: Sequence[str] = (),
    taken: int = 0,
) -> dict[str, Any]:
    """Return the card of a checkpoint; as `write_card_draft`, from and as plain values.

    The robot lies in `robot_folder`, or is found by its name; `taken` is as in `CheckpointFacts`.

    Returns:
        `text`; and as `widths` what its input may take, likeliest first, where the card guesses it
        and to run the module would tell.

    Raises:
        PolicyError: as `inspect_checkpoint` and `write_card_draft`.
        UsageError: there is no such robot.
    """
    know_robot(robot, None if robot_folder is None else Path(robot_folder))
    joints = len(get_robot(robot).joints)
    facts = replace(inspect_checkpoint(Path(checkpoint)), taken=taken, joints=joints)
    text = write_card_draft(
        facts,
        get_robot(robot),
        folder=Path(folder),
        layout=layout,
        beside=beside,
        statistics=None if statistics is None else Path(statistics),
        motions=motions,
        feeders=feeders,
    )
    return {"text": text, "widths": _widths(facts, get_robot(robot), beside or {})}


def _widths(facts: CheckpointFacts, robot: RobotSpec, beside: Mapping[str, str]) -> tuple[int, ...]:
    """Return what a script's one input may take where nothing says it: first what is drafted."""
    guessed = widths_to_try(facts)
    if not guessed or pipeline_of(beside, facts.path.name) is not None:
        return ()
    known = read_beside(beside, robot, str(facts.path), facts.exporter)
    terms = sized_terms(known.observation_terms, len(robot.joints)) if known else ()
    sizes = [(term.width or 0) * (term.history or 1) for term in terms]
    named = (sum(sizes),) if sizes and all(sizes) else ()
    return tuple(dict.fromkeys((*named, *guessed)))


def width_taken(*, checkpoint: str, widths: Sequence[int]) -> int:
    """As `nw_policies.torchscript.width_taken`, from plain values."""
    from nw_policies.torchscript import width_taken as taken  # It takes torch.

    return taken(Path(checkpoint), widths)


def _name(path: Path) -> str:
    """Return the file's name, or its folder's where the file is called as all of them are."""
    own = slug(path.stem)
    folder = slug(path.parent.resolve().name)
    return (folder if _NAMELESS.fullmatch(path.stem) else own) or own or "policy"


def _file_below(facts: CheckpointFacts, folder: Path | None) -> tuple[str, bool]:
    """Return the checkpoint's path below a card's folder, and whether it lies there."""
    # A link counts by where it lies, not by what it points to.
    path = facts.path.parent.resolve() / facts.path.name
    base = path.parent if folder is None else folder.resolve()
    beside = path.is_relative_to(base)
    return path.relative_to(base).as_posix() if beside else path.name, beside


def _checkpoint(facts: CheckpointFacts, folder: Path | None) -> list[str]:
    file, beside = _file_below(facts, folder)
    lines = ["checkpoint:", f"  file: {quoted(file)}"]
    if not beside:
        note = "it does not lie beside this card: copy it there, or give --checkpoint"
        lines.insert(1, f"  {CHECK} {note}")
    return [*lines, f"  sha256: {facts.sha256}"]


def _summary(facts: CheckpointFacts) -> list[str]:
    name = plain(facts.path.name)
    lines = [f"# Drafted from {name} ({facts.format}). Lines with CHECK are not from it."]
    for kind, arrays in (("input", facts.inputs), ("output", facts.outputs)):
        lines += [f"# {kind} {plain(a.name)}: {_shape(a.shape)} {a.dtype}" for a in arrays]
    if facts.parameters:
        lines.append(f"# {facts.parameters:,} numbers in its tensors")
    if facts.recurrent:
        lines.append(f"# recurrent state: {plain(', '.join(facts.recurrent))}")
    return lines


def _body(
    facts: CheckpointFacts, layout: str | None, robot: RobotSpec, feeders: Sequence[str] = ()
) -> tuple[list[str], list[ObservationDraft]]:
    """Return command, observations, inputs and output as lines; and the observations."""
    if (known := known_observations(facts)) is not None:
        _refuse_unknown(layout, [], facts.path)
        return known, []
    joints = len(robot.joints)
    by_input, networks = with_encoders(_parts(facts, layout, joints), facts, feeders)
    parts = [part for several in by_input.values() for part in several]
    body = [*networks, "observations:"]
    for part in parts:
        body += [f"  {part.name}:", *(f"    {line}" for line in part.lines)]
    if any("command" in line.split("#")[0] for line in body):
        body = [_follower(facts.exporter, robot), "", *body]
    if len(parts) > 1:
        listed = {argument.name for argument in facts.script if argument.images}
        inputs: list[str] = []
        for name, several in by_input.items():
            combined = f"[{', '.join(part.fed or part.name for part in several)}]"
            inputs.append(
                f"{quoted(name)}: {f'{{list: {combined}}}' if name in listed else combined}"
            )
        body += ["", f"inputs: {{{', '.join(inputs)}}}"]
    if len(facts.outputs) > 1:
        first, *rest = sorted(facts.outputs, key=lambda output: _unlikeness(output, joints))
        others = plain(", ".join(array.name for array in rest if array.name not in TABLES))
        body += ["", f"output: {quoted(first.name)}" + (f"  {CHECK} or {others}" if others else "")]
    return body, parts


def _trained_speeds(known: ExporterMetadata | None) -> list[str]:
    if known is None or not known.speeds:
        return []
    ranges = ", ".join(f"{key}: {in_brackets(limits)}" for key, limits in known.speeds.items())
    return [f"trained_speeds: {{{ranges}}}{_from(known, 'speeds')}"]


def _follower(known: ExporterMetadata | None, robot: RobotSpec) -> str:
    """Return the line `command`, no faster than the training commanded.

    Many policies of two legs turn only while they walk.
    """
    speeds = known.speeds if known else {}
    fastest = min(0.8, speeds["lin_vel_x"][1]) if "lin_vel_x" in speeds else 0.8
    turning = min(1.0, speeds["ang_vel_z"][1]) if "ang_vel_z" in speeds else 1.0
    limit = f", yaw_limit: {number(turning)}" if 0 < turning < 1.0 else ""
    speed = max(fastest, 0.0)
    if len(robot.feet) < _ENOUGH_FEET:
        limit += f", least_speed: {number(min(_TURNING_SPEED, speed))}"
    line = f"command: {{source: trail_follower, speed: {number(speed)}{limit}}}"
    if known is None or not speeds:
        return f"{line}  # steers towards the next waypoint"
    return f"{line}  # as trained_speeds"


def _unlikeness(output: ArrayFacts, joints: int) -> tuple[bool, bool]:
    """Return what an output is sorted by that may be the action: the likeliest comes first."""
    return output.shape[-1:] not in {(joints,), (None,)}, not _ACTION.search(output.name)


def _parts(
    facts: CheckpointFacts, layout: str | None, joints: int
) -> dict[str, list[ObservationDraft]]:
    """Return the observations that make each input, all of one layout where they can be."""
    likely = Likely(names=(layout,)) if layout else likely_layouts(facts)
    by_input = _parts_of_layout(facts, likely, joints)
    fits = [part.fits[0] for several in by_input.values() for part in several if part.fits]
    if fits and not likely.names:
        # Frames before the present one tell more than a frame alone.
        frame, _ = max(fits, key=lambda fit: fit[1])
        by_input = _parts_of_layout(facts, Likely(names=(frame.name,)), joints)
    _refuse_unknown(layout, [part for several in by_input.values() for part in several], facts.path)
    return by_input


def _parts_of_layout(
    facts: CheckpointFacts, likely: Likely, joints: int
) -> dict[str, list[ObservationDraft]]:
    known = facts.exporter or ExporterMetadata()
    terms = sized_terms(known.observation_terms, joints)
    source, clip = known.sources.get("observation_terms", ""), known.observation_clip
    by_input: dict[str, list[ObservationDraft]] = {}
    names: set[str] = set()
    wanted_by_name = wanted_inputs(facts)
    # The exporter's terms are those of the first input that is not an image or a scan, and of
    # others that hold more or fewer frames of them.
    rows = [w for w in wanted_by_name if not (w.seen or is_scan(w.array.name))]
    for wanted in wanted_by_name:
        own: tuple[ExportedTerm, ...] = ()
        if wanted in rows:
            own = terms_for(terms, wanted.size, alone=len(rows) == 1, name=wanted.array.name)
            own = own or (terms if wanted is rows[0] else ())
        parts = parts_of(wanted.resized(own), own, likely)
        if own:
            frames = [{term.history or 1 for term in each} for each in (terms, own)]
            note = (
                f"{CHECK} {source or 'the file'} says {max(frames[0])} frames of them, the "
                f"checkpoint takes {max(frames[1])}"
            )
            notes = [note] if len(rows) == 1 and frames[0] != frames[1] else []
            parts = tuple(_said(part, source, clip, notes) for part in parts)
        by_input[wanted.array.name] = [_renamed(part, names) for part in parts]
    return by_input


def _said(
    part: ObservationDraft, source: str, clip: float | None, notes: Sequence[str]
) -> ObservationDraft:
    """Return a row of named terms with the file that names them, its clip, and notes."""
    first, *others = part.lines
    if part.fits or not source:
        return part
    clips = [f"clip: {number(clip)}  # {source}"] if clip and first == "sensor: proprio" else []
    return replace(part, lines=(f"{first}  # {source} names its terms", *notes, *others, *clips))


def _refuse_unknown(layout: str | None, parts: Sequence[ObservationDraft], path: Path) -> None:
    known = dict.fromkeys(frame.name for part in parts for frame, _ in part.fits)
    if layout is not None and layout not in known:
        raise PolicyError(
            f"{path}: its inputs do not fit the layout {layout!r}",
            fix=nearest(layout, known) if known else "none is guessed here: leave --layout out",
        )


def _renamed(part: ObservationDraft, taken: set[str]) -> ObservationDraft:
    """Return a part by a name that no other has, which is then taken."""
    name, count = part.name, 2
    while name in taken:
        name, count = f"{part.name}_{count}", count + 1
    taken.add(name)
    return replace(part, name=name)


def _shape(shape: Sequence[int | None]) -> str:
    return " x ".join("?" if size is None else str(size) for size in shape) or "scalar"


def control_lines(
    exporter: ExporterMetadata | None,
    robot: RobotSpec,
    frame: Frame | None,
    clip: tuple[float, float] | None = None,
    folder: Path | None = None,
) -> list[str]:
    """Return the lines of `control`.

    Args:
        exporter: what the file says.
        robot: whose own values stand where it is unknown anything.
        frame: the layout of what the policy sees, if it is guessed: its training says the rest.
        clip: the limits of actions in the trainer's own inference.
        folder: where networks of motors lie.
    """
    known = exporter or ExporterMetadata()
    theirs = published(frame, robot) if frame else {}
    of = f"{CHECK} as {frame.name};" if frame else CHECK
    late = theirs.get("delay_steps", "0")
    return [
        "control:",
        *_rates(known),
        *_action(known, theirs, of, clip),
        *_joints(known, robot, frame),
        *_pose_and_gains(known, robot, theirs, of),
        *_motor_limits(known, robot),
        *motor_lines(known.motors, folder or Path(), _from(known, "motors")),
        f"  delay_steps: {late}  {CHECK} control steps between an action and its result",
    ]


def _from(known: ExporterMetadata, field: str) -> str:
    """Return the comment that says which file a line is from; none for the checkpoint's own."""
    return f"  # {known.sources[field]}" if field in known.sources else ""


def _rates(known: ExporterMetadata) -> list[str]:
    """Return the lines of how often a policy acts, and the physics of its training."""
    rate, physics = known.rate, known.physics_rate
    if rate is None:
        lines = [f"  rate: 50  {CHECK} actions per second of the training"]
    elif rate in {50, 25, 10, 5, 2, 1}:
        lines = [f"  rate: {number(rate)}{_from(known, 'rate')}"]
    else:
        return _own_rates(known, rate)
    if physics not in {None, 200}:
        said = f"{known.sources.get('physics_rate', 'the file')} says {number(physics or 0)}"
        lines.append(f"  # physics_rate: 200  {said}; the protocol takes 200 alone")
    return lines


def _own_rates(known: ExporterMetadata, rate: float) -> list[str]:
    """Return the lines of a rate that does not divide 50, with physics of whole steps of it."""
    wanted = (known.physics_rate or PHYSICS_RATE, *range(PHYSICS_RATE, MOST_PHYSICS_RATE + 1))
    fits = (p for p in wanted if PHYSICS_RATE <= p <= MOST_PHYSICS_RATE and p % 1 == 0)
    physics = next((p for p in fits if p / rate >= 1 and abs(p / rate - round(p / rate)) < 1e-6), 0)
    source = known.sources.get("rate", "the file")
    if not 1 <= rate <= MOST_PHYSICS_RATE or not physics:
        return [f"  rate: 50  {CHECK} {source} says {number(rate)}, which no card can have"]
    note = f"{source}; a suite of the protocol neverwhere-2026 takes 50 alone"
    return [f"  rate: {number(rate)}  # {note}", f"  physics_rate: {number(physics)}"]


def _action(
    known: ExporterMetadata, theirs: Mapping[str, str], of: str, clip: tuple[float, float] | None
) -> list[str]:
    """Return the lines of what an action means."""
    meaning = f"  {CHECK} target = default_pose + scale * action"
    meaning = _from(known, "action") or meaning
    lines = [f"  action: {known.action or 'joint_position_offset'}{meaning}"]
    if known.action_scale:
        lines.append(f"  scale: {one_or_list(known.action_scale)}{_from(known, 'action_scale')}")
    else:
        lines.append(f"  scale: {theirs.get('scale', '0.25')}  {of} rad for each unit of action")
    if (limits := known.action_clip or clip) is not None:
        text = number(limits[1]) if limits[0] == -limits[1] else in_brackets(limits)
        source = "  # as the trainer plays its policies" if known.action_clip is None else ""
        lines.append(f"  clip: {text}{source or _from(known, 'action_clip')}")
    elif "clip" in theirs:
        lines.append(f"  clip: {theirs['clip']}  {of} limits before scaling")
    return lines


def _pose_and_gains(
    known: ExporterMetadata, robot: RobotSpec, theirs: Mapping[str, str], of: str
) -> list[str]:
    lines: list[str] = []
    if known.default_joint_pos:
        pose = one_or_list(known.default_joint_pos)
        lines.append(f"  default_pose: {pose}{_from(known, 'default_joint_pos')}")
    elif "default_pose" in theirs:
        lines.append(f"  default_pose: {theirs['default_pose']}  {of} rad")
    else:
        pose = _by_joint(robot, robot.default_pose)
        lines.append(f"  # default_pose: {pose}  {CHECK} the {robot.name}'s own is used")
    for name, field, own in (
        ("kp", "joint_stiffness", robot.kp),
        ("kd", "joint_damping", robot.joint_damping),
    ):
        if name == "kp" and known.action == "joint_torque":
            continue  # It has no meaning there.
        if values := getattr(known, field):
            lines.append(f"  {name}: {one_or_list(values)}{_from(known, field)}")
        elif name in theirs:
            note = f"{of} the {robot.name}'s own is {_motors(robot, own)}"
            lines.append(f"  {name}: {theirs[name]}  {note}")
        else:
            lines.append(f"  {name}: {_motors(robot, own)}  {CHECK} the {robot.name}'s own")
    rounded = {"default_joint_pos", "joint_stiffness"} - set(known.sources)
    if any(getattr(known, field) for field in rounded):
        lines.append("  # The exporter rounds these numbers to three decimals.")
    return lines


def _motor_limits(known: ExporterMetadata, robot: RobotSpec) -> list[str]:
    lines: list[str] = []
    for name, values, own, unit in (
        ("torque_limits", known.torque_limits, _by_joint(robot, robot.torque_limits), "N m"),
        ("armature", known.armature, _motors(robot, robot.armature), "kg m^2"),
        ("friction_loss", known.friction_loss, _motors(robot, robot.friction_loss), "N m"),
    ):
        if values:
            lines.append(f"  {name}: {one_or_list(values)}{_from(known, name)}")
            continue
        note = f"{unit}; not in the file: the {robot.name}'s own is used"
        lines.append(f"  # {name}: {own}  {CHECK} {note}")
    if values := known.viscous_friction:
        source = _from(known, "viscous_friction")
        lines.append(f"  viscous_friction: {one_or_list(values)}{source}")
    return lines


def published(frame: Frame, robot: RobotSpec) -> dict[str, str]:
    """Return the actions and motors of a layout's training, as lines of a card."""
    own = [short_name(joint) for joint in robot.joints]
    is_of_them = sorted(frame.joints or own) == sorted(own)
    values = {"joints": f"[{', '.join(_ordered(frame, robot) or own)}]"}
    if is_of_them or "{" not in frame.scale:
        values["scale"] = frame.scale
    if frame.clip is not None:
        values["clip"] = number(frame.clip)
    if frame.pose is not None and is_of_them:
        values["default_pose"] = frame.pose
    # Layouts are published with the gains of Go1 and Go2, which carry no other robot.
    if frame.gains is not None and robot.name in BUILT_IN:
        values["kp"], values["kd"] = map(number, frame.gains)
    if frame.delay:
        values["delay_steps"] = str(frame.delay)
    return values


def _ordered(frame: Frame, robot: RobotSpec) -> tuple[str, ...]:
    """Return a robot's joints as a layout's training counts them; empty where that is unknown."""
    if sorted(frame.joints) == sorted(short_name(joint) for joint in robot.joints):
        return frame.joints
    return isaac_lab_order(robot) if frame.family == "isaac-lab" else ()


def _joints(known: ExporterMetadata, robot: RobotSpec, frame: Frame | None) -> list[str]:
    own = [short_name(joint) for joint in robot.joints]
    names = [short_name(name) for name in known.joint_names]
    if names and sorted(names) == sorted(own):
        source = _from(known, "joint_names")
        if known.guessed_order:
            source = f"  {CHECK} the order of the checkpoint: {known.sources['joint_names']} "
            source += "names no order"
        return [f"  joints: [{', '.join(names)}]{source}"]
    if frame is not None and _ordered(frame, robot):
        return [f"  joints: {published(frame, robot)['joints']}  {CHECK} as {frame.name}"]
    return [f"  joints: [{', '.join(own)}]  {CHECK} the order of the checkpoint"]


def _motors(robot: RobotSpec, values: Sequence[float]) -> str:
    """Return values as one number where all joints have it, else as a mapping."""
    return number(values[0]) if len(set(values)) == 1 else _by_joint(robot, values)


def _by_joint(robot: RobotSpec, values: Sequence[float]) -> str:
    """Return values as a mapping, by the kind of joint where that says it all."""
    names = [short_name(joint) for joint in robot.joints]
    kinds = [name.rpartition("_")[2] for name in names]
    by_kind = dict(zip(kinds, values, strict=True))
    if all(by_kind[kind] == value for kind, value in zip(kinds, values, strict=True)):
        pairs = by_kind.items()
    else:
        pairs = zip(names, values, strict=True)
    return f"{{{', '.join(f'{name}: {number(value)}' for name, value in pairs)}}}"


def other_layouts(parts: Sequence[ObservationDraft], robot: RobotSpec) -> list[str]:
    """Return lines that say each of them in full; none where there is but one.

    Args:
        parts: the observations of the draft.
        robot: whose joints they order.
    """
    drafted = {part.fits[0][0].name for part in parts if part.fits}
    others = {frame.name: frame for part in parts for frame, _ in part.fits[1:]}
    others = {name: frame for name, frame in others.items() if name not in drafted}
    if not others:
        return []
    whose = robot.name if robot.name in BUILT_IN else "FOLDER"
    command = f"nw-eval policies init CHECKPOINT --robot {whose} --layout NAME --out NAME.yaml"
    lines = [
        "",
        f"# This card is of {' and '.join(sorted(drafted))}. Other published layouts of its sizes:",
        f"# {', '.join(others)}. To write a card of one of these layouts:",
        f"#     {command}",
        "# `nw-eval policies check` tells which of them walks.",
    ]
    for name, frame in others.items():
        lines += ["#", f"# {name} ({frame.source}): {frame.traits}", "#   control:"]
        values = published(frame, robot)
        lines += [f"#     {key}: {value}" for key, value in values.items()]
        lines.append("#   observations:")
        for part in parts:
            if name in part.ways:
                lines.append(f"#     {part.name}:")
                lines += [f"#       {line}" for line in map(_uncommented, part.ways[name]) if line]
    return lines


def _uncommented(line: str) -> str:
    return line.partition(CHECK)[0].rstrip()
