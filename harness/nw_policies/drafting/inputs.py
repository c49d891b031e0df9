"""The observations that may make each input of a checkpoint, as lines of a card."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from nw_policies.drafting.checkpoint import ArrayFacts, CheckpointFacts, ScriptInput
from nw_policies.drafting.exporters import ExportedTerm
from nw_policies.drafting.layouts import SCANS, frames_of, is_scan
from nw_policies.drafting.notation import CHECK, RATE_LINE, key
from nw_policies.drafting.tracking import TIME_STEP
from nw_policies.drafting.vectors import (
    Likely,
    ObservationDraft,
    guessed_parts,
    named_parts,
    zeros,
    zeros_note,
)

_WEIGHT = re.compile(r"(^|\.)weight(_ih_l0)?$")
_TRIES = 12
"""Widths that a module is asked to take."""
_BRIGHTNESS = re.compile(r"gr[ae]y|mono|rgb|colou?r|intensity", re.IGNORECASE)
_IMAGE = re.compile(r"depth|image|img|rgb|camera|pixel", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """An input that a card must feed."""

    array: ArrayFacts
    reason: str
    """How its size is known, for a comment."""
    known: bool = True
    """Whether the size is in the file."""
    images: tuple[int | None, ...] = ()
    """Channels of each image, where it is a list of them."""
    is_guess: bool = False
    """Whether the size is taken from the widths of layers, one of which may be the input's."""

    @property
    def size(self) -> int | None:
        """Numbers of a row; None where the file does not say."""
        shape = _without_batch(self.array.shape)
        sure = self.known and not self.is_guess and len(shape) <= 1
        return (*shape, 1)[0] if sure else None

    def resized(self, terms: Sequence[ExportedTerm]) -> Wanted:
        """Return the input with the size of its terms, where its own is not known."""
        total = sum((term.width or 0) * (term.history or 1) for term in terms)
        if not total or (self.known and not self.is_guess) or not all(t.width for t in terms):
            return self
        array = replace(self.array, shape=(1, total))
        known = self.is_guess and self.array.shape == array.shape
        return replace(self, array=array, known=known, is_guess=False)

    @property
    def seen(self) -> bool:
        """Whether it looks like an image."""
        axes = len(_without_batch(self.array.shape))
        return axes >= 3 or (axes == 2 and bool(_IMAGE.search(self.array.name)))


def wanted_inputs(facts: CheckpointFacts) -> tuple[Wanted, ...]:
    """Return the inputs of a checkpoint; where its format does not say them, likely ones."""
    if facts.inputs:
        return tuple(
            Wanted(array=array, reason=f"terms are guessed from the size, {_form(array.shape)}")
            for array in facts.inputs
        )
    layers = [tensor for tensor in facts.tensors if len(tensor.shape) == 2]
    known, sizes = _likely_widths(facts)
    reason = (
        f"its layers take {sorted({tensor.shape[1] for tensor in layers})}"
        if layers
        else "it has no linear layer that would tell, so 48 is assumed"
    )
    if len(facts.script) > 1:
        return tuple(
            _argument(argument, min(known, default=48), reason) for argument in facts.script
        )
    direct = facts.script[0].size if facts.script else None
    if direct is not None:
        reason = f"the layer that its one input goes into takes {direct}; {reason}"
    else:
        what = "of what size its input is" if facts.script else "how many inputs it takes, of what"
        seen = f"on zeros it runs with {facts.taken}; " if facts.taken else ""
        reason = f"the file does not say {what}; {seen}{reason}"
    size = direct or facts.taken or (known or sizes or [48])[0]
    array = ArrayFacts(name="obs", shape=(1, size), dtype="float32")
    return (Wanted(array=array, reason=reason, is_guess=not (direct or facts.taken)),)


def _likely_widths(facts: CheckpointFacts) -> tuple[list[int], list[int]]:
    """Return the widths of layers that may be an input's: of known frames, and all of them."""
    weights = [t for t in facts.tensors if len(t.shape) == 2 and _WEIGHT.search(t.name)]
    outputs = {tensor.shape[0] for tensor in weights}
    # What no layer makes is an input: of 45 -> 512 -> 256 -> 12 that is 45, not the widest.
    sizes = [tensor.shape[1] for tensor in weights if tensor.shape[1] not in outputs]
    sizes = sizes or [tensor.shape[1] for tensor in weights]
    return [size for size in sizes if frames_of(size, facts.joints)], sizes


def widths_to_try(facts: CheckpointFacts) -> tuple[int, ...]:
    """Return possible sizes of a script's one input, likeliest first; empty if the file has it.

    The first is what `wanted_inputs` guesses. A module that keeps its own history takes a frame,
    and its first layer takes several.
    """
    one = facts.script[0] if len(facts.script) == 1 else None
    if one is None or one.size is not None or one.kind != "Tensor":
        return ()
    known, sizes = _likely_widths(facts)
    widths = [
        width
        for size in (*known, *sizes)
        for width in (
            size,
            *(frame.size for frame, count in frames_of(size, facts.joints) if count > 1),
        )
    ]
    return tuple(dict.fromkeys(widths))[:_TRIES]


def parts_of(
    wanted: Wanted, terms: Sequence[ExportedTerm], likely: Likely
) -> tuple[ObservationDraft, ...]:
    """Return the observations that make an input together, in their order.

    Args:
        wanted: the input.
        terms: what the exporter says that it is made of; empty where it does not.
        likely: layouts that are taken before others.
    """
    array, name = wanted.array, key(wanted.array.name)
    if wanted.images:
        return tuple(
            ObservationDraft(
                name=f"{name}_{index}" if len(wanted.images) > 1 else name,
                lines=tuple(_image(array, (channels or 1, None, None))),
            )
            for index, channels in enumerate(wanted.images)
        )
    if array.name == TIME_STEP:
        lines = ("sensor: reference", "terms: [frame]  # of the motion that the file holds")
        return (ObservationDraft(name=name, lines=lines),)
    batch, shape = _batch(array.shape), _without_batch(array.shape)
    if wanted.seen:
        lines = _image(array, shape) if len(shape) >= 3 else _depth(shape)
        return (ObservationDraft(name=name, lines=tuple(lines)),)
    if len(shape) == 2:
        return (_rows(wanted, shape, terms, likely),)
    size = shape[0] or 0 if shape else 0
    parts = _row(name, size, wanted, terms, likely)
    if batch > 1:
        note = (
            f"{CHECK} the checkpoint wants a batch of {batch}: export it with batch 1 or a free "
            f"batch (if these are {batch} frames: `wrap: [{{wrapper: stack, steps: {batch}}}]`)"
        )
        return (_noted(parts[0], note), *parts[1:])
    return parts if wanted.known else (_noted(parts[0], f"{CHECK} its size is not in the file"),)


def _row(
    name: str, size: int, wanted: Wanted, terms: Sequence[ExportedTerm], likely: Likely
) -> tuple[ObservationDraft, ...]:
    reason = wanted.reason
    if terms and not is_scan(wanted.array.name):
        if parts := named_parts(name, size, terms):
            return parts
        reason = f"the file names no terms of its {size} numbers"
    return guessed_parts(name, size, reason, likely)


def _rows(
    wanted: Wanted, shape: Sequence[int | None], terms: Sequence[ExportedTerm], likely: Likely
) -> ObservationDraft:
    """Return an observation of frames that stand on an axis of their own."""
    name, (steps, size) = key(wanted.array.name), (n or 0 for n in shape)
    of_steps, of_size = (frames_of(each, likely.joints) for each in (steps, size))
    last = not terms and bool(of_steps) and not of_size
    steps, size = (size, steps) if last else (steps, size)
    # Here the frames of a term are rows, whatever the exporter calls their history.
    parts = _row(name, size, wanted, [replace(term, history=1) for term in terms], likely)
    part = parts[0]
    if len(parts) > 1:
        lines = ("sensor: proprio", *zeros(size, "frames with a scan, which no card can make"))
        part = ObservationDraft(name=name, lines=lines)
    if not steps:
        part, steps = _noted(part, f"{CHECK} the file leaves the number of frames free"), 10
    if not 2 <= steps <= 100:
        return _noted(part, f"{CHECK} no card makes this axis of {steps}: export it without")
    axis = ", axis: last" if last else ""
    wrap = f"wrap: [{{wrapper: stack, steps: {steps}{axis}}}]"
    if not terms or any(term.history != steps for term in terms):
        wrap += f"  {CHECK} the oldest frame comes first"
    ways = {name: (*lines, wrap) for name, lines in part.ways.items()}
    return replace(part, lines=(*part.lines, wrap), ways=ways)


def _argument(argument: ScriptInput, frame: int, reason: str) -> Wanted:
    """Return an argument of a scripted module that takes several."""
    shape: tuple[int | None, ...] = (1, argument.size)
    if argument.size is None:
        scan = SCANS[0].size if is_scan(argument.name) else frame
        shape = (1, None, None, None) if _IMAGE.search(argument.name) else (1, scan)
    if argument.kind == "List[Tensor]":
        reason = f"it is a list of tensors; {reason}"
    elif argument.kind != "Tensor":
        reason = (
            f"it is a {argument.kind}, which no card can feed: export it with tensors; {reason}"
        )
    elif argument.size is not None:
        reason = f"the layer that it goes into takes {argument.size}; {reason}"
    return Wanted(
        array=ArrayFacts(name=argument.name, shape=shape, dtype="float32"),
        reason=reason,
        known=argument.size is not None,
        images=argument.images,
    )


def _batch(shape: Sequence[int | None]) -> int:
    """Return the length of a fixed first axis before a row of numbers; 1 where it is free."""
    return shape[0] or 1 if len(shape) == 2 else 1


def _without_batch(shape: tuple[int | None, ...]) -> tuple[int | None, ...]:
    return shape[1:] if shape[:1] in {(1,), (None,)} or len(shape) == 2 else shape


def _form(shape: tuple[int | None, ...]) -> str:
    return " x ".join("?" if n is None else str(n) for n in _without_batch(shape)) or "0"


def _noted(part: ObservationDraft, note: str) -> ObservationDraft:
    return replace(part, lines=(part.lines[0], note, *part.lines[1:]))


def image_lines(array: ArrayFacts) -> list[str]:
    """Return the lines of an image that a network takes."""
    return _image(array, _without_batch(array.shape))


def _image(array: ArrayFacts, shape: tuple[int | None, ...]) -> list[str]:
    stack, (first, second, third) = shape[0] if len(shape) == 4 else None, shape[-3:]
    chw = first is None or first in {1, 3} or (third not in {1, 3} and first < (third or 0))
    (channels, height, width) = (first, second, third) if chw else (third, first, second)
    is_grey = channels == 1 and bool(_BRIGHTNESS.search(array.name))
    if ("depth" in array.name.lower() or channels not in {3, None}) and not is_grey:
        return _depth((height, width), channels=channels or 1, chw=chw, stack=stack)
    lines = [
        "sensor: splat_rgb",
        f"camera: ego  {CHECK} a camera of the robot",
        *_sizes(height, width),
        RATE_LINE,
    ]
    if is_grey:
        lines += _wraps("grayscale", *_channel(chw=chw), *_stacked(stack))
    else:
        lines.append(f"axes: {'chw' if chw else 'hwc'}")
    if stack and not is_grey:
        lines.append(f"stack: {stack}")
    if array.dtype == "uint8":
        return [*lines, "dtype: uint8"]
    return [*lines, "dtype: float32", f"mean: 0  {CHECK} (byte - mean) / std", "std: 255"]


def _sizes(height: int | None, width: int | None) -> list[str]:
    note = "" if height and width else f"  {CHECK} the file leaves the size of the image free"
    return [f"width: {width or 80}{note}", f"height: {height or 45}"]


def _channel(*, chw: bool) -> list[str]:
    """Return the wrapper that gives a flat image an axis for its one channel."""
    return [f"{{wrapper: channels, axis: {'first' if chw else 'last'}}}"]


def _stacked(steps: int | None, axis: str = "first") -> list[str]:
    return [f"{{wrapper: stack, steps: {steps}, axis: {axis}}}"] if steps and steps > 1 else []


def _wraps(*wrappers: str) -> list[str]:
    return [f"wrap: [{', '.join(wrappers)}]"] if wrappers else []


def _depth(
    shape: tuple[int | None, ...],
    *,
    channels: int = 0,
    chw: bool = True,
    stack: int | None = None,
) -> list[str]:
    """Return a depth image; its channels are frames, 0 = there is no axis of channels."""
    wraps = _channel(chw=chw) if channels == 1 else _stacked(channels, "first" if chw else "last")
    notes = [f"{CHECK} its {channels} channels are taken for frames, oldest first"]
    return [
        "sensor: depth",
        *(notes if channels > 1 else ()),
        f"camera: ego  {CHECK} a camera of the robot, and its near and far",
        *_sizes(*shape),
        RATE_LINE,
        *_wraps(*wraps, *_stacked(stack)),
    ]


_LUCIDSIM = """\
observations:
  proprio: {sensor: proprio, layout: parkour53}
  rgb:
    sensor: splat_rgb
    camera: ego
    width: 80
    height: 45
    sampling: published
    stack: 7
    axes: chw
    dtype: float32
    mean: 127.5
    std: 255

inputs: {proprio: [proprio], frames: [rgb]}"""
_BODY = """\
observations:
  proprio: {sensor: proprio, layout: parkour53}
  history:  # the ten frames before the present one, without their heading
    sensor: proprio
    layout: parkour53
    history: {steps: 10, current: false, zero: ["6:8"]}
"""
_EXPERT = """\
  scandots: {sensor: scandots}

inputs: {proprio: [proprio], scandots: [scandots], history: [history]}"""
_STUDENT = """\
  depth:
    sensor: depth
    camera: ego
    width: 80
    height: 45
    rate: 10
    wrap:  # CHECK: near and far of the training, here 0.28 and 2 m
      - {wrapper: clip, limits: [0.28, 2.0]}
      - {wrapper: normalize, mean: 0.28, std: 1.72}
      - {wrapper: scale, offset: -0.5}

inputs: {proprio: [proprio], depth: [depth], history: [history]}
options: {depth_every: 5, steer_by_depth: true}"""


def known_observations(facts: CheckpointFacts) -> list[str] | None:
    """Return the lines of a card for a known network; None for one whose inputs must be guessed."""
    match facts.adapter:
        case "lucidsim":
            return [*_LUCIDSIM.splitlines()]
        case "extreme-parkour":
            student = any(t.name.startswith("depth_encoder_state_dict.") for t in facts.tensors)
            note = ["# The file holds the expert too: feed it `scandots` in place of `depth`."]
            text = _BODY + (_STUDENT if student else _EXPERT)
            return [*(note if student else []), *text.splitlines()]
        case "act":
            return _act(facts)
        case _:
            return None


def _act(facts: CheckpointFacts) -> list[str]:
    shapes = {tensor.name.removeprefix("model."): tensor.shape for tensor in facts.tensors}
    size = shapes["encoder_robot_state_input_proj.weight"][1]
    chunk = shapes["decoder_pos_embed.weight"][0]
    images = any(name.startswith("backbone.") for name in shapes)
    proprio = (
        "layout: parkour53"
        if size == 53
        else f"terms: [{{term: constant, value: 0, width: {size}}}]"
    )
    note = f"{CHECK} {size} numbers" if size == 53 else zeros_note(size)
    lines = [
        "# CHECK: the weights do not say how many attention heads share them",
        f"options: {{heads: 8, ensemble: 0.01, query_every: 1}}  # a chunk has {chunk} actions",
        "",
        "observations:",
        f"  proprio: {{sensor: proprio, {proprio}}}  {note}",
    ]
    if images:
        lines += [
            "  rgb:",
            "    sensor: splat_rgb",
            "    camera: ego",
            "    width: 320  # CHECK: the size of the training images",
            "    height: 180",
            f"    {RATE_LINE}",
            "    axes: chw",
            "    dtype: float32",
            "    mean: 0  # CHECK: (byte - mean) / std",
            "    std: 255",
        ]
    inputs = "proprio: [proprio]" + (", images: [rgb]" if images else "")
    return [*lines, "", f"inputs: {{{inputs}}}"]
