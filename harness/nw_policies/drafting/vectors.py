"""The observations that may make one row of numbers, as lines of a card.

Where the exporter names the terms of a row, they are those; else the published layouts of its size
are guessed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

from nw_base.plural import plural
from nw_policies.drafting.checkpoint import CheckpointFacts
from nw_policies.drafting.exporters import ExportedTerm, HeightGrid
from nw_policies.drafting.layouts import (
    PARKOUR,
    SCANS,
    TERM_OF,
    Frame,
    ScanGuess,
    frames_before_a_scan,
    frames_of,
    is_scan,
    scan_of,
)
from nw_policies.drafting.notation import CHECK, in_brackets, number, plain
from nw_policies.drafting.tracking import AHEAD, REFERENCE_TERM_OF

_COMMAND = "velocity_commands"
_WIDEST = 10_000
"""Numbers of one constant term."""


@dataclass(frozen=True, kw_only=True)
class ObservationDraft:
    """One observation: its name on the card, and the lines below that."""

    name: str
    lines: tuple[str, ...]
    ways: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    """What may stand in place of the lines behind `sensor`, by the layout that has it so."""
    fed: str = ""
    """The network that takes it, in whose place the checkpoint does not; empty = none."""
    fits: tuple[tuple[Frame, int], ...] = ()
    """Frames that it may hold, and how many of each: what the lines have first."""


def named_parts(
    name: str, size: int, terms: Sequence[ExportedTerm]
) -> tuple[ObservationDraft, ...]:
    """Return observations of the terms that an exporter names, in its order.

    Terms of one history stand in one observation; a scan of heights is one of its own. Empty where
    no number is left for any of them.
    """
    sizes = _sizes(terms, size)
    # Terms without an entry in the draft have the size 0: others stand in for them.
    rows = [(term, width) for term, width in zip(terms, sizes, strict=True) if width]
    groups = [list(group) for _, group in groupby(rows, key=lambda row: _kind(row[0]))]
    total = sum(width * (term.history or 1) for term, width in rows)
    size = size or total  # A free size is that of the terms.
    left_out = [plain(term.name) for term, width in zip(terms, sizes, strict=True) if not width]
    parts: list[ObservationDraft] = []
    for group in groups:
        first, width = group[0]
        if _is_scan(first):
            lines = scan_lines(width, term=first)
            own = f"{name}_scan" if len(groups) > 1 else name
        else:
            lines = _terms(group, left_out)
            own = f"{name}_motion" if motion_term_of(first) else name
            if first.select:
                own = f"{name}_{first.name}"
        if any(part.name == own for part in parts):
            own = f"{own}_{len(parts) + 1}"
        parts.append(ObservationDraft(name=own, lines=tuple(lines)))
    notes = _missing(terms)
    if left_out and all(term_of(term) or _is_scan(term) for term, _ in rows):
        notes.append(f"{CHECK} no numbers are left for {', '.join(left_out)}")
    if len(groups) == 1 and total < size and size % total == 0 and terms[0].history is None:
        times = size // total
        history = f"history: {{steps: {times}, by: term}}  {CHECK} {size} = {times} x {total}"
        parts[0] = ObservationDraft(name=parts[0].name, lines=(*parts[0].lines, history))
    elif total != size:
        notes.append(
            f"{CHECK} these terms make {plural(total, 'number')}, the checkpoint wants {size}"
        )
    if not parts:
        return ()
    sensor, *others = parts[0].lines
    return (ObservationDraft(name=parts[0].name, lines=(sensor, *notes, *others)), *parts[1:])


def term_of(term: ExportedTerm) -> tuple[str, int | None] | None:
    """Return our word for a term, and its size: by its function, else by its name."""
    if term.own:
        return term.own, term.width
    known = motion_term_of(term) or TERM_OF.get(term.function) or TERM_OF.get(term.name)
    if known is None and term.name.endswith(_COMMAND):
        known = TERM_OF[_COMMAND]  # unitree_rl_lab has `keyboard_velocity_commands`.
    if known is not None and known[0] == "clock" and not term.keys:
        return None  # Its rate is unknown.
    return known


def motion_term_of(term: ExportedTerm) -> tuple[str, int | None] | None:
    """Return our words for a term of the motion that is tracked; None of any other term."""
    own = term.name.rpartition("/")[2]  # rl_sar has the name of the training before it.
    return REFERENCE_TERM_OF.get(term.function) or REFERENCE_TERM_OF.get(own)


def sized_terms(terms: Sequence[ExportedTerm], joints: int) -> tuple[ExportedTerm, ...]:
    """Return terms with the width that those have of which it is known.

    Args:
        terms: as files name them.
        joints: of the robot.
    """
    sized: list[ExportedTerm] = []
    for term in terms:
        known = term_of(term)
        if known is not None:
            # Isaac Lab's function `joint_pos` is absolute, mjlab's and others' terms are not.
            keys = "relative: false" if term.function == "joint_pos" else term.keys
            each = joints * (known[0].count("+") + 1)  # Of each of its words.
            term = replace(term, width=each if known[1] is None else known[1], keys=keys)  # noqa: PLW2901 - the same term.
        sized.append(term)
    return tuple(sized)


def terms_for(
    terms: Sequence[ExportedTerm], size: int | None, *, alone: bool, name: str
) -> tuple[ExportedTerm, ...]:
    """Return the terms of one input, whose history may be longer than another's; empty if unknown.

    DreamWaQ and teacher-student policies see the newest frame as one input and frames before it as
    another.

    Args:
        terms: as a file names them, with their widths.
        size: numbers of the input; None where it is not known.
        alone: whether it is the only row of numbers.
        name: of the input; one with `hist` in it holds the history.
    """
    frame = sum(term.width or 0 for term in terms)
    if not frame or not all(term.width for term in terms) or any(map(_is_scan, terms)):
        return ()
    steps = {term.history or 1 for term in terms}
    if size is None:
        return tuple(
            term if alone or "hist" in name else replace(term, history=1) for term in terms
        )
    if size == sum((term.width or 0) * (term.history or 1) for term in terms):
        return tuple(terms)
    if size % frame == 0 and len(steps) == 1 and (size == frame or max(steps) > 1):
        return tuple(replace(term, history=size // frame) for term in terms)
    return ()


def _is_scan(term: ExportedTerm) -> bool:
    return is_scan(term.name) or is_scan(term.function)


def zeros(size: int, what: str = "what the checkpoint really sees") -> list[str]:
    """Return lines that make `size` zeros in place of `what`; very many by a history."""
    steps = 1 if size <= _WIDEST else max(n for n in range(1, 101) if size % n == 0)
    full, rest = divmod(size // steps, _WIDEST)
    parts = [_WIDEST] * full + ([rest] if rest else [])
    lines = [zeros_note(size, what), "terms:"]
    lines += [f"  - {{term: constant, value: 0, width: {n}}}" for n in parts]
    return lines if steps == 1 else [*lines, f"history: {{steps: {steps}}}"]


def zeros_note(size: int, what: str = "what the checkpoint really sees") -> str:
    """Return a comment that stands out: zeros run without an error and carry no information."""
    return (
        f"{CHECK} THESE {size} ZEROS STAND FOR {what}: the policy is blind to it until they are "
        "replaced"
    )


def _kind(term: ExportedTerm) -> tuple[str, int, bool]:
    # A card selects from a whole observation, so a term in an order of its own is one.
    is_apart = _is_scan(term) or term.select
    kind = "motion" if motion_term_of(term) else term.name if is_apart else ""
    return kind, term.history or 1, term.keeps_one


def _sizes(terms: Sequence[ExportedTerm], size: int) -> list[int]:
    """Return how many numbers each term has at a time; what is not known shares what is left."""
    widths = [0 if _is_scan(term) and not term.width else term.width or 0 for term in terms]
    left = size - sum(
        width * (term.history or 1) for term, width in zip(terms, widths, strict=True)
    )
    scans = [i for i, term in enumerate(terms) if _is_scan(term) and not term.width]
    unknown = [i for i, width in enumerate(widths) if not width and i not in scans]
    for i in scans:
        steps = terms[i].history or 1
        fair = left // (len(scans) * steps) if not unknown else min(SCANS[0].size, left // steps)
        widths[i] = max(fair, 0)
    left -= sum(widths[i] * (terms[i].history or 1) for i in scans)
    if unknown and left > 0:
        widths[unknown[0]] = left // (terms[unknown[0]].history or 1)
    return widths


def _terms(group: Sequence[tuple[ExportedTerm, int]], left_out: Sequence[str]) -> list[str]:
    is_motion = motion_term_of(group[0][0]) is not None
    lines = [f"sensor: {'reference' if is_motion else 'proprio'}", "terms:"]
    for term, width in group:
        keys, unread = _keys(term, width)
        if known := term_of(term):
            for word in known[0].split("+"):
                line = f"  - {{term: {word}{keys}}}" if keys else f"  - {word}"
                lines.append(f"{line}  # {plain(term.name)}")
        else:
            others = plain(", ".join([term.name, *left_out]))
            lines += [
                f"  {zeros_note(width, others)}",
                f"  - {{term: constant, value: 0, width: {width}}}",
            ]
        if unread:
            lines[-1] += f"  {CHECK} its {unread} cannot be read"
    if is_motion:
        lines.append(AHEAD)
    if places := group[0][0].select:
        listed = ", ".join(map(str, places))
        lines.append(f"select: [{listed}]  # its joints are in another order than the action's")
    if (steps := group[0][0].history or 1) > 1 or group[0][0].keeps_one:
        form = group[0][0].form
        if group[0][0].select:  # One term's frames stand alike by term and by step.
            form = form.replace("by: term", "by: step")
        lines.append(f"history: {{steps: {steps}, {form}}}")
        if any(term.flat_history is False for term, _ in group):
            lines[-1] += f"  {CHECK} the exporter says that its frames are not in one row"
    return lines


def _keys(term: ExportedTerm, width: int) -> tuple[str, str]:
    """Return `scale` and `clip` of a term as a card writes them, and what does not fit it."""
    keys, unread = f", {term.keys}" if term.keys else "", ""
    if term.scale is not None and len(term.scale) not in {1, width}:
        unread = "scale"
    elif term.scale is not None and set(term.scale) != {1.0}:
        one = len(set(term.scale)) == 1
        keys += f", scale: {number(term.scale[0]) if one else in_brackets(term.scale)}"
    if term.clip is not None and not all(map(math.isinf, term.clip)):
        # A card has no infinite limits.
        keys += f", clip: {in_brackets([max(min(limit, 1e6), -1e6) for limit in term.clip])}"
    return keys, unread


def _missing(terms: Sequence[ExportedTerm]) -> list[str]:
    """Return comments that say which columns of the metadata are absent, and for which terms."""
    notes: list[str] = []
    everywhere: list[str] = []
    for what, absent in (
        ("scale", [plain(term.name) for term in terms if term.scale is None]),
        ("clip", [plain(term.name) for term in terms if term.clip is None]),
    ):
        if len(absent) == len(terms):
            everywhere.append(f"{what}s")
        elif absent:
            notes.append(f"{CHECK} the {what} of {', '.join(absent)} cannot be read in the file")
    if everywhere:
        notes.insert(0, f"{CHECK} {' and '.join(everywhere)} are not in the file")
    return notes


TOPS = frozenset({"base", "base_link", "trunk", "pelvis", "body"})
"""Names of the body at the top of a robot, from which a card's scan counts heights."""


def scan_lines(
    size: int, *, term: ExportedTerm | None = None, frame: Frame | None = None
) -> list[str]:
    """Return the lines of a grid of heights, by a known convention or by what the file says.

    Args:
        size: points.
        term: what the exporter says of it, if anything.
        frame: the layout that it stands behind, if that is known.
    """
    grid = None if term is None else term.grid
    factor = term.scale[0] if term and term.scale and len(set(term.scale)) == 1 else None
    if frame is not None and frame.scan_scale != 1.0:
        factor = frame.scan_scale
    if term is not None and grid is not None and grid.x[2] * grid.y[2] == size:
        lines = _stated_scan(grid, term, factor)
    else:
        scan = scan_of(size)
        if scan is None:
            return ["sensor: proprio", *zeros(size, f"a scan of {size} heights")]
        if scan is PARKOUR and term is None:
            return [
                "sensor: scandots",
                f"{CHECK} {size} heights: extreme-parkour's grid, {scan.x} x {scan.y}",
            ]
        lines = _guessed_scan(scan, term, frame, factor)
    wrap: list[str] = []
    if factor not in {None, 1.0}:
        wrap.append(f"{{wrapper: scale, scale: {number(factor or 1.0)}}}")
    if term is not None and (term.history or 1) > 1:
        wrap += [f"{{wrapper: stack, steps: {term.history}}}", "{wrapper: flatten}"]
    return [*lines, f"wrap: [{', '.join(wrap)}]"] if wrap else lines


def _stated_scan(grid: HeightGrid, term: ExportedTerm, factor: float | None) -> list[str]:
    """Return the lines of a grid that the training's configuration states."""
    lines = ["sensor: scandots"]
    if grid.body and grid.body not in TOPS:
        lines.append(
            f"{CHECK} the training counts heights from {grid.body}, this card from the root"
        )
    lines += [
        f"x: {in_brackets(grid.x)}",
        f"y: {in_brackets(grid.y)}",
        f"order: {grid.order}",
        f"offset: {number(grid.offset)}",
    ]
    low, high = term.clip or (-math.inf, math.inf)
    if math.isinf(low) or math.isinf(high):
        # mjlab divides by the longest ray and reads that length where there is no ground.
        reach = 1 / factor if factor is not None and 0 < factor < 1 else 5.0
        low, high = max(low, -reach), min(high, reach)
        return [*lines, f"clip: {in_brackets((low, high))}  {CHECK} the training has no limit"]
    return [*lines, f"clip: {in_brackets((low, high))}"]


def _guessed_scan(
    scan: ScanGuess, term: ExportedTerm | None, frame: Frame | None, factor: float | None
) -> list[str]:
    """Return the lines of a grid of which only the number of points is known."""
    sides = "the grid of Isaac Lab and mjlab" if scan in SCANS and scan != PARKOUR else "a guess"
    ahead, left = (scan.x - 1) / 20, (scan.y - 1) / 20
    order = frame.scan if frame else "x_fastest"
    lines = [
        "sensor: scandots",
        f"{CHECK} {scan.size} heights: {scan.x} x {scan.y} points 0.1 m apart are {sides}",
        f"x: {in_brackets((0.0 - ahead, ahead, scan.x))}",
        f"y: {in_brackets((0.0 - left, left, scan.y))}",
        f"order: {order}  {CHECK} x_fastest as Isaac Lab and mjlab; y_fastest in legged_gym",
    ]
    if term is not None and term.clip is not None and all(map(math.isinf, term.clip)):
        # mjlab divides by the longest ray and reads that length where there is no ground.
        reach = 1 / factor if factor is not None and 0 < factor < 1 else 5.0
        lines += [
            f"offset: 0  {CHECK} as mjlab; -0.5 in Isaac Lab and legged_gym",
            f"clip: {in_brackets((-reach, reach))}  {CHECK} no ground reads {number(reach)} m",
        ]
    else:
        low, high = term.clip if term and term.clip else (-1.0, 1.0)
        lines += [
            f"offset: -0.5  {CHECK} as Isaac Lab and legged_gym; 0 in mjlab",
            f"clip: {in_brackets((max(low, -1e6), min(high, 1e6)))}",
        ]
    if factor is None:
        lines.append(f"{CHECK} no scale, as Isaac Lab; {{wrapper: scale, scale: 5}} in legged_gym")
    return lines


@dataclass(frozen=True, kw_only=True)
class Likely:
    """Layouts that are taken before others, by name, and the sign in the file that speaks so."""

    names: tuple[str, ...] = ()
    sign: str = ""
    joints: int = 12
    """Of the robot that the checkpoint drives."""


_LAB_NAMES = ("isaac-lab", "unitree-rl-lab", "robot-lab")


def likely_layouts(facts: CheckpointFacts) -> Likely:
    """Return the layouts whose trainings save a checkpoint like this one."""
    names = {tensor.name for tensor in facts.tensors}
    likely = Likely()
    if any(name.startswith("estimator.") for name in names):
        likely = Likely(names=("himloco",), sign="it has an estimator, as HIMLoco's have")
    elif "0.weight" in names and facts.adapter != "onnx":
        likely = Likely(names=("legged-gym",), sign="it is an actor alone, as legged_gym saves it")
    elif "actor.0.weight" in names:
        likely = Likely(names=_LAB_NAMES, sign="it is saved as in Isaac Lab")
    elif any(array.name == "continuous_actions" for array in facts.outputs):
        likely = Likely(
            names=("playground", "playground-biped"), sign="its output is called as Playground's"
        )
    return replace(likely, joints=facts.joints)


def guessed_parts(
    name: str, size: int, reason: str, likely: Likely
) -> tuple[ObservationDraft, ...]:
    """Return observations that make `size` numbers together, guessed from that number.

    Args:
        name: the checkpoint's name of the input, as a key.
        size: its numbers; 0 if it is free.
        reason: how the size is known, for the comment.
        likely: layouts that are taken before others.
    """
    fits, scan = frames_of(size, likely.joints), None
    if is_scan(name) or (not fits and any(scan.size == size for scan in SCANS)):
        return (ObservationDraft(name=name, lines=tuple(scan_lines(size or SCANS[0].size))),)
    if not fits:
        fits, scan = frames_before_a_scan(size, likely.joints)
    note = f"{CHECK} {reason}"
    if not fits:
        note += (
            "; no known layout has it, so these are zeros" if size else ": the file leaves it free"
        )
        frames = [f"{n} frames of {size // n}" for n in range(2, 21) if _may_repeat(size, n)]
        if frames:
            note += f"; it may be {' or '.join(frames)} numbers"
        lines = ("sensor: proprio", note, *zeros(max(size, 1)))
        return (ObservationDraft(name=name, lines=lines),)
    fits = sorted(fits, key=lambda fit: fit[0].name not in likely.names)
    frame, count = fits[0]
    after = f" + {scan.size} heights" if scan else ""
    note += f": {frame.source} ({count} x {frame.size}{after})"
    if len(fits) > 1:
        note += f"; or {', '.join(f'{f.source} ({n} x {f.size}{after})' for f, n in fits[1:])}"
    if likely.sign and frame.name in likely.names:
        note += f"; {likely.sign}"
    ways = {frame.name: tuple(frame_lines(frame, count)) for frame, count in reversed(fits)}
    lines = ("sensor: proprio", note, *ways[frame.name])
    if count > 1:
        lines = (*lines[:-1], f"{lines[-1]}  {CHECK} oldest_first? by: term?")
    body = ObservationDraft(name=name, lines=lines, ways=ways, fits=tuple(fits))
    if scan is None:
        return (body,)
    heights = {frame.name: tuple(scan_lines(scan.size, frame=frame)) for frame, _ in fits}
    own = heights[frame.name]
    return (body, ObservationDraft(name=f"{name}_scan", lines=own, ways=heights))


def _may_repeat(size: int, steps: int) -> bool:
    """Whether a row may be frames of a robot with twelve joints: 45 to 65 numbers each."""
    return size % steps == 0 and 45 <= size // steps <= 65


def frame_lines(frame: Frame, count: int) -> list[str]:
    """Return the lines of `count` frames of a layout, below the line `sensor`."""
    if frame.layout is not None:
        lines = [f"layout: {frame.layout}"]
    else:
        lines = ["terms:", *(f"  - {term}" for term in frame.terms)]
    if frame.clip is not None:
        lines.append(f"clip: {number(frame.clip)}")
    if count > 1:
        lines.append(f"history: {{steps: {count}, {frame.history}}}")
    return lines
