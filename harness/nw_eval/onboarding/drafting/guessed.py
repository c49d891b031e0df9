"""The published layouts that may make one row of numbers, as lines of a card."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.onboarding.drafting.frames import Frame, frames_of
from nw_eval.onboarding.drafting.guesses import SCANS, frames_before_a_scan, is_scan
from nw_eval.onboarding.drafting.vectors import ObservationDraft, scan_lines, zeros
from nw_eval.onboarding.reading.facts import CheckpointFacts
from nw_eval.onboarding.reading.text import CHECK, number


@dataclass(frozen=True, kw_only=True)
class Likely:
    """Layouts that are taken before others, by name, and the sign in the file that speaks so."""

    names: tuple[str, ...] = ()
    sign: str = ""


def likely_layouts(facts: CheckpointFacts) -> Likely:
    """Return the layouts whose trainings save a checkpoint like this one."""
    names = {tensor.name for tensor in facts.tensors}
    if any(name.startswith("estimator.") for name in names):
        return Likely(names=("himloco",), sign="it has an estimator, as HIMLoco's have")
    if "0.weight" in names:
        return Likely(names=("legged-gym",), sign="it is an actor alone, as legged_gym saves it")
    if "actor.0.weight" in names:
        return Likely(
            names=("isaac-lab", "unitree-rl-lab", "robot-lab"), sign="it is saved as in Isaac Lab"
        )
    if any(array.name == "continuous_actions" for array in facts.outputs):
        return Likely(names=("playground",), sign="its output is called as Playground's")
    return Likely()


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
    if is_scan(name) or (not frames_of(size) and any(scan.size == size for scan in SCANS)):
        return (ObservationDraft(name=name, lines=tuple(scan_lines(size or SCANS[0].size))),)
    fits, scan = frames_of(size), None
    if not fits:
        fits, scan = frames_before_a_scan(size)
    note = f"{CHECK} {reason}"
    if not fits:
        note += (
            "; no known layout has it, so these are zeros" if size else ": the file leaves it free"
        )
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
