"""A first card for a checkpoint: valid YAML, with what must be checked said in comments."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from nw_eval.errors import PolicyError, nearest
from nw_eval.onboarding.drafting.arrays import parts_of, wanted_inputs
from nw_eval.onboarding.drafting.guessed import Likely, likely_layouts
from nw_eval.onboarding.drafting.guesses import is_scan
from nw_eval.onboarding.drafting.known import known_observations
from nw_eval.onboarding.drafting.motors import control_lines
from nw_eval.onboarding.drafting.others import other_layouts
from nw_eval.onboarding.drafting.vectors import ObservationDraft
from nw_eval.onboarding.reading.facts import EXPORT, ArrayFacts, CheckpointFacts, inspect_checkpoint
from nw_eval.onboarding.reading.text import CHECK, plain, quoted, slug
from nw_eval.robots import RobotSpec, get_robot

_ACTION = re.compile(r"action|\bmu\b|mean|joint|target", re.IGNORECASE)
_NAMELESS = re.compile(r"(policy|model)([._-].*)?", re.IGNORECASE)


def write_card_draft(
    facts: CheckpointFacts,
    robot: RobotSpec,
    folder: Path | None = None,
    layout: str | None = None,
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

    Raises:
        PolicyError: the file holds weights of a network that is not known here, or does not fit
            `layout`.
    """
    if facts.adapter is None:
        shown = ", ".join(f"{tensor.name} {tensor.shape}" for tensor in facts.tensors[:3])
        raise PolicyError(
            f"{facts.path}: weights of an unknown network: {shown}, ...",
            fix=f"{EXPORT}, which hold the network too",
        )
    body, parts = _body(facts, layout, len(robot.joints))
    frames = [part.fits[0][0] for part in parts if part.fits]
    # What one of them feeds back clipped, `control` must clip.
    frame = next((f for f in frames if f.clip is not None), frames[0] if frames else None)
    lines = [
        *_summary(facts),
        "nw-policy: 1",
        f"name: {_name(facts.path)}",
        'title: ""  # one line for people',
        f'licence: ""  {CHECK} under which terms may others run it?',
        f"robot: {robot.name}",
        f"adapter: {facts.adapter}",
        *_checkpoint(facts, folder),
        "",
        *control_lines(facts.exporter, robot, frame),
        "",
        *body,
        *other_layouts(parts, robot),
    ]
    return "\n".join(lines) + "\n"


def draft_of(*, checkpoint: str, robot: str, folder: str, layout: str | None = None) -> str:
    """Return the card of a checkpoint; as `write_card_draft`, from plain values.

    Raises:
        PolicyError: as `inspect_checkpoint` and `write_card_draft`.
        UsageError: there is no such robot.
    """
    facts = inspect_checkpoint(Path(checkpoint))
    return write_card_draft(facts, get_robot(robot), folder=Path(folder), layout=layout)


def _name(path: Path) -> str:
    """Return the file's name, or its folder's where the file is called as all of them are."""
    own = slug(path.stem)
    folder = slug(path.parent.resolve().name)
    return (folder if _NAMELESS.fullmatch(path.stem) else own) or own or "policy"


def _checkpoint(facts: CheckpointFacts, folder: Path | None) -> list[str]:
    # A link counts by where it lies, not by what it points to.
    path = facts.path.parent.resolve() / facts.path.name
    base = path.parent if folder is None else folder.resolve()
    beside = path.is_relative_to(base)
    file = path.relative_to(base).as_posix() if beside else path.name
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
    facts: CheckpointFacts, layout: str | None, joints: int
) -> tuple[list[str], list[ObservationDraft]]:
    """Return command, observations, inputs and output as lines; and the observations."""
    if (known := known_observations(facts)) is not None:
        _refuse_unknown(layout, [], facts.path)
        return known, []
    by_input = _parts(facts, layout)
    parts = [part for several in by_input.values() for part in several]
    body = ["observations:"]
    for part in parts:
        body += [f"  {part.name}:", *(f"    {line}" for line in part.lines)]
    if any("command" in line.split("#")[0] for line in body):
        follow = "command: {source: trail_follower, speed: 0.8}  # steers towards the next waypoint"
        body = [follow, "", *body]
    if len(parts) > 1:
        listed = {argument.name for argument in facts.script if argument.images}
        inputs: list[str] = []
        for name, several in by_input.items():
            combined = f"[{', '.join(part.name for part in several)}]"
            inputs.append(
                f"{quoted(name)}: {f'{{list: {combined}}}' if name in listed else combined}"
            )
        body += ["", f"inputs: {{{', '.join(inputs)}}}"]
    if len(facts.outputs) > 1:
        first, *rest = sorted(facts.outputs, key=lambda output: _unlikeness(output, joints))
        others = plain(", ".join(array.name for array in rest))
        body += ["", f"output: {quoted(first.name)}  {CHECK} or {others}"]
    return body, parts


def _unlikeness(output: ArrayFacts, joints: int) -> tuple[bool, bool]:
    """Return what an output is sorted by that may be the action: the likeliest comes first."""
    return output.shape[-1:] not in {(joints,), (None,)}, not _ACTION.search(output.name)


def _parts(facts: CheckpointFacts, layout: str | None) -> dict[str, list[ObservationDraft]]:
    """Return the observations that make each input, all of one layout where they can be."""
    likely = Likely(names=(layout,)) if layout else likely_layouts(facts)
    by_input = _parts_of_layout(facts, likely)
    fits = [part.fits[0] for several in by_input.values() for part in several if part.fits]
    if fits and not likely.names:
        # Frames before the present one tell more than a frame alone.
        frame, _ = max(fits, key=lambda fit: fit[1])
        by_input = _parts_of_layout(facts, Likely(names=(frame.name,)))
    _refuse_unknown(layout, [part for several in by_input.values() for part in several], facts.path)
    return by_input


def _parts_of_layout(facts: CheckpointFacts, likely: Likely) -> dict[str, list[ObservationDraft]]:
    terms = facts.exporter.observation_terms if facts.exporter else ()
    by_input: dict[str, list[ObservationDraft]] = {}
    names: set[str] = set()
    for wanted in wanted_inputs(facts):
        # The exporter's terms are those of the first input that is no image and no scan.
        plain_row = not (wanted.seen or is_scan(wanted.array.name))
        parts = parts_of(wanted, terms if plain_row else (), likely)
        by_input[wanted.array.name] = [_renamed(part, names) for part in parts]
        terms = () if plain_row else terms
    return by_input


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
