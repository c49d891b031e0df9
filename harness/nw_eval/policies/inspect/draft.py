"""A first card for a checkpoint: valid YAML, with what must be checked said in comments."""

from __future__ import annotations

import re
from collections.abc import Sequence

from nw_eval.errors import PolicyError
from nw_eval.policies.inspect.exporter import ExporterMetadata
from nw_eval.policies.inspect.facts import ArrayFacts, CheckpointFacts
from nw_eval.policies.inspect.guesses import TERM_OF, FrameGuess, frames_of
from nw_eval.policies.inspect.known import known_observations
from nw_eval.policies.joints import short_name
from nw_eval.robots import RobotSpec

_CHECK = "# CHECK:"


def write_card_draft(facts: CheckpointFacts, robot: RobotSpec) -> str:
    """Return the text of a card, to be saved as policy.yaml beside the checkpoint.

    It is a valid card of the checkpoint's sizes. Lines with `CHECK:` are guesses or defaults.

    Args:
        facts: from `inspect_checkpoint`.
        robot: the robot that the policy drives.

    Raises:
        PolicyError: the file holds weights of a network that is not known here.
    """
    if facts.adapter is None:
        shown = ", ".join(f"{tensor.name} {tensor.shape}" for tensor in facts.tensors[:3])
        raise PolicyError(
            f"{facts.path}: weights of an unknown network: {shown}, ...",
            fix="export the policy as ONNX or with torch.export, which hold the network too",
        )
    lines = [
        *_summary(facts),
        "nw-policy: 1",
        f"name: {_slug(facts.path.stem)}",
        'title: ""  # one line for people',
        f'licence: ""  {_CHECK} under which terms may others run it?',
        f"robot: {robot.name}",
        f"adapter: {facts.adapter}",
        "checkpoint:",
        f"  file: {_quoted(facts.path.name)}",
        f"  sha256: {facts.sha256}",
        "",
        *_control(facts.exporter, robot),
        "",
        *_body(facts),
    ]
    return "\n".join(lines) + "\n"


def _summary(facts: CheckpointFacts) -> list[str]:
    lines = [
        f"# Drafted from {facts.path.name} ({facts.format}). Lines with CHECK are not from it."
    ]
    for kind, arrays in (("input", facts.inputs), ("output", facts.outputs)):
        lines += [f"# {kind} {a.name}: {_shape(a.shape)} {a.dtype}" for a in arrays]
    if facts.parameters:
        lines.append(f"# {facts.parameters:,} numbers in its tensors")
    if facts.recurrent:
        lines.append(f"# recurrent state: {', '.join(facts.recurrent)}")
    return lines


def _control(exporter: ExporterMetadata | None, robot: RobotSpec) -> list[str]:
    known = exporter or ExporterMetadata()
    lines = [
        "control:",
        f"  rate: 50  {_CHECK} actions per second of the training",
        f"  action: joint_position_offset  {_CHECK} target = default_pose + scale * action",
    ]
    if known.action_scale:
        lines.append(f"  scale: {_numbers(known.action_scale)}")
    else:
        lines.append(f"  scale: 0.25  {_CHECK} rad for each unit of action")
    lines += _joints(known, robot)
    if known.default_joint_pos:
        lines.append(f"  default_pose: {_numbers(known.default_joint_pos)}")
    else:
        pose = ", ".join(
            f"{short_name(joint)}: {angle:g}"
            for joint, angle in zip(robot.joints, robot.default_pose, strict=True)
        )
        lines.append(f"  # default_pose: {{{pose}}}  {_CHECK} the {robot.name}'s own is used")
    for key, values, own in (
        ("kp", known.joint_stiffness, robot.kp),
        ("kd", known.joint_damping, robot.joint_damping),
    ):
        if values:
            lines.append(f"  {key}: {_numbers(values)}")
        else:
            lines.append(f"  {key}: {own:g}  {_CHECK} the {robot.name}'s own")
    if known.default_joint_pos or known.joint_stiffness:
        lines.append("  # The exporter rounds these numbers to three decimals.")
    lines.append(f"  delay_steps: 0  {_CHECK} control steps between an action and its effect")
    return lines


def _joints(known: ExporterMetadata, robot: RobotSpec) -> list[str]:
    own = [short_name(joint) for joint in robot.joints]
    names = [short_name(name) for name in known.joint_names]
    if not names:
        return [f"  joints: [{', '.join(own)}]  {_CHECK} the order of the checkpoint"]
    if sorted(names) == sorted(own):
        return [f"  joints: [{', '.join(names)}]"]
    return [
        f"  # The file names the joints {', '.join(known.joint_names)[:400]}",
        f"  joints: [{', '.join(own)}]  {_CHECK} they are not the {robot.name}'s",
    ]


def _body(facts: CheckpointFacts) -> list[str]:
    """Return command, observations, inputs and output."""
    if (known := known_observations(facts)) is not None:
        return known
    arrays = facts.inputs or (_undeclared(facts),)
    observations: list[str] = []
    inputs: list[str] = []
    commanded = False
    for array in arrays:
        name = _slug(array.name).replace("-", "_").replace(".", "_")
        lines = _observation(array, facts)
        commanded = commanded or any("command" in line.split("#")[0] for line in lines)
        observations += [f"  {name}:", *(f"    {line}" for line in lines)]
        inputs.append(f"{_quoted(array.name)}: [{name}]")
    body = ["command: {source: trail_follower, speed: 0.8}  # steers towards the next waypoint", ""]
    body = [*(body if commanded else []), "observations:", *observations]
    if len(arrays) > 1:
        body += ["", f"inputs: {{{', '.join(inputs)}}}"]
    if len(facts.outputs) > 1:
        others = ", ".join(array.name for array in facts.outputs[1:])
        body += ["", f"output: {_quoted(facts.outputs[0].name)}  {_CHECK} or {others}"]
    return body


def _undeclared(facts: CheckpointFacts) -> ArrayFacts:
    """Stand in for the input of a scripted module, which does not say what it takes."""
    sizes = [
        tensor.shape[1]
        for tensor in facts.tensors
        if len(tensor.shape) == 2 and re.search(r"(^|\.)(0\.)?weight(_ih_l0)?$", tensor.name)
    ]
    known = [size for size in sizes if frames_of(size)]
    size = max(known or sizes or [48])
    return ArrayFacts(name="obs", shape=(1, size), dtype="float32")


def _observation(array: ArrayFacts, facts: CheckpointFacts) -> list[str]:
    shape = array.shape[1:] if array.shape[:1] in {(1,), (None,)} else array.shape
    if len(shape) >= 3:
        return _image(array, shape)
    size = shape[0] if len(shape) == 1 and shape[0] is not None else 0
    if len(shape) == 2 and None not in shape:
        size = (shape[0] or 0) * (shape[1] or 0)
    if facts.exporter is not None and facts.exporter.observation_names:
        return _named_terms(facts.exporter.observation_names, size)
    guesses = frames_of(size)
    if not facts.inputs:
        sizes = sorted({t.shape[1] for t in facts.tensors if len(t.shape) == 2})
        note = f"{_CHECK} the file does not say what it takes; its layers take {sizes}"
    else:
        note = f"{_CHECK} terms are guessed from the size, {size}"
    if guesses:
        frame, count = guesses[0]
        others = ", ".join(f"{g.source} ({n} x {g.size})" for g, n in guesses[1:])
        note += f": {frame.source} ({count} x {frame.size})"
        note += f"; or {others}" if others else ""
        return ["sensor: proprio", note, *_frame(frame), *_history(count)]
    return [
        "sensor: proprio",
        f"{note}; no known layout has it, so these are zeros",
        *_zeros(max(size, 1)),
    ]


def _frame(frame: FrameGuess) -> list[str]:
    if frame.layout is not None:
        return [f"layout: {frame.layout}"]
    return ["terms:", *(f"  - {term}" for term in frame.terms)]


def _history(count: int) -> list[str]:
    if count == 1:
        return []
    history = f"history: {{steps: {count}, order: newest_first, by: step}}"
    return [f"{history}  {_CHECK} oldest_first? by: term?"]


def _named_terms(names: Sequence[str], size: int) -> list[str]:
    """Return the terms that the exporter names, as far as we know them."""
    known = sum(TERM_OF[name][1] for name in names if name in TERM_OF)
    unknown = [name for name in names if name not in TERM_OF]
    lines = ["sensor: proprio", f"{_CHECK} scales and clips are not in the file", "terms:"]
    for name in names:
        if name in TERM_OF:
            lines.append(f"  - {{term: {TERM_OF[name][0]}, scale: 1.0}}  # {name}")
        elif name == unknown[0] and size > known:
            lines.append(f"  - {{term: constant, values: {_list([0.0] * (size - known))}}}")
            lines[-1] += f"  {_CHECK} in place of {', '.join(unknown)}"
    total = known if not unknown else max(size, known)
    if total and size % total == 0 and size > total:
        lines.append(
            f"history: {{steps: {size // total}, by: term}}  {_CHECK} {size} = {size // total} x "
            f"{total}"
        )
    elif total != size:
        lines.append(f"{_CHECK} these terms make {total} numbers, the checkpoint wants {size}")
    return lines


def _zeros(size: int) -> list[str]:
    """Return lines that make `size` zeros: as few as can be, repeated by a history."""
    steps = max(n for n in range(1, 101) if size % n == 0)
    full, rest = divmod(size // steps, 1000)
    parts = [1000] * full + ([rest] if rest else [])
    lines = ["terms:", *(f"  - {{term: constant, values: {_list([0.0] * n)}}}" for n in parts)]
    return lines if steps == 1 else [*lines, f"history: {{steps: {steps}}}"]


def _image(array: ArrayFacts, shape: tuple[int | None, ...]) -> list[str]:
    stack, (first, second, third) = shape[0] if len(shape) == 4 else None, shape[-3:]
    chw = first in {1, 3, None}
    height, width = (second, third) if chw else (first, second)
    lines = [
        "sensor: splat_rgb",
        f"camera: ego  {_CHECK} a camera of the robot",
        f"width: {width or 80}",
        f"height: {height or 45}",
        f"axes: {'chw' if chw else 'hwc'}",
    ]
    if stack:
        lines.append(f"stack: {stack}")
    if array.dtype == "uint8":
        return [*lines, "dtype: uint8"]
    return [*lines, "dtype: float32", f"mean: 0  {_CHECK} (byte - mean) / std", "std: 255"]


def _slug(name: str) -> str:
    slug = re.sub(r"[^a-z0-9._-]+", "-", name.lower()).strip("-._")
    return slug[:64] or "policy"


def _quoted(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z_][\w.-]*", name) else '"' + name.replace('"', "") + '"'


def _shape(shape: Sequence[int | None]) -> str:
    return " x ".join("?" if size is None else str(size) for size in shape) or "scalar"


def _numbers(values: Sequence[float]) -> str:
    return f"{values[0]:g}" if len(set(values)) == 1 else _list(values)


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{value:g}' for value in values)}]"
