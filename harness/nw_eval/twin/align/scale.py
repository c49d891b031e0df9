"""How long a unit of a capture is: every cue that there is, the most trusted first.

Lengths and heights that somebody measured lie between points in space, or points picked in shots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import PrerequisiteError, UsageError, nearest
from nw_eval.plural import plural
from nw_eval.scenes.scene import Vector
from nw_eval.twin.align.alignment import MOST_DIFFERENCE, AlignOptions, KnownLength, Pixel, ScaleCue
from nw_eval.twin.align.positions import PositionFit
from nw_eval.twin.align.tags import PlacedTag, find_tags, place_tags
from nw_eval.twin.align.triangulate import triangulate
from nw_eval.twin.capture import Capture

Values = NDArray[np.float64]

_VAGUE = 0.02
"""A scale by positions that is known worse is worth a word."""
_GIVE = (
    "lay a printed tag36h11 tag into view and give its edge (tag_edge), or give camera_height, a "
    "known height or length, the shots' positions, or say that the poses are metric"
)

_TOLERANCE = 8.0
"""Pixels that a picked point may be off: hands are less exact than detectors."""


@dataclass(frozen=True, kw_only=True)
class ScaleAnswer:
    """Metres in a unit, each cue's answer, and what somebody should look at."""

    scale: float
    cues: tuple[ScaleCue, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _ScaleBy:
    name: str
    scale: float
    reason: str


def find_scale(
    capture: Capture,
    folder: Path,
    options: AlignOptions,
    *,
    up: Values,
    floor: float | None,
    positions: PositionFit | None,
    say: Callable[[str], None],
) -> ScaleAnswer:
    """Return the scale by tags, else by a height, else by poses, else by a length.

    Args:
        capture: with its pictures in `folder`.
        folder: of the capture.
        options: what somebody knows.
        up: (3,) unit vector in the capture's frame.
        floor: height of the floor along it, in the capture's unit; None = none was found.
        positions: the fit to known positions; None without.
        say: hears of the tags that are found.

    Raises:
        UsageError: nothing gives a scale; or what gives it makes no sense.
        PrerequisiteError: what finds tags is not installed.
        SceneError: a picture cannot be read.
    """
    warnings: list[str] = []
    answers = [
        *_by_tags(capture, folder, options, warnings, say),
        *_by_camera_height(capture, options, up, floor, warnings),
        *_by_lengths(capture, options, up, vertical=True),
        *_by_poses(options, positions, warnings),
        *_by_lengths(capture, options, up, vertical=False),
    ]
    if not answers:
        raise UsageError(_nothing(capture, folder, options, warnings), fix=_GIVE)
    chosen = answers[0].scale
    cues = tuple(
        ScaleCue(
            name=one.name,
            scale=one.scale,
            difference=one.scale / chosen - 1.0,
            used=place == 0,
            reason=one.reason,
        )
        for place, one in enumerate(answers)
    )
    return ScaleAnswer(scale=chosen, cues=cues, warnings=tuple(warnings))


def _by_tags(
    capture: Capture,
    folder: Path,
    options: AlignOptions,
    warnings: list[str],
    say: Callable[[str], None],
) -> list[_ScaleBy]:
    if options.tag_edge is None and not options.tag_edges:
        return []
    found = find_tags(capture, folder, options.tag_family, say)
    edges = {
        number: edge
        for number in found
        if (edge := options.tag_edges.get(number, options.tag_edge)) is not None
    }
    tags = place_tags(capture, {number: found[number] for number in edges})
    lost = sorted(edges.keys() - {tag.number for tag in tags})
    if lost:
        warnings.append(f"no two shots agree on where these tags are: {_listed(lost)}")
    if not tags:
        if not lost:
            warnings.append(f"no {options.tag_family} tag of known edge is in any picture")
        return []
    return [_tag_answer(tags, edges, warnings)]


def _tag_answer(tags: list[PlacedTag], edges: dict[int, float], warnings: list[str]) -> _ScaleBy:
    """Return the mean of the tags' scales, each as often as shots agree on it."""
    logs = np.array([math.log(edges[tag.number] / tag.edge) for tag in tags])
    shots = np.array([tag.shots for tag in tags])
    middle = float((shots * logs).sum() / shots.sum())
    spread = float(np.abs(np.expm1(logs - middle)).max())
    if spread > MOST_DIFFERENCE:
        worst = tags[int(np.argmax(np.abs(logs - middle)))].number
        warnings.append(
            f"the tags disagree by {spread:.1%} about the scale, tag {worst} most: is its edge "
            f"{edges[worst]:g} m?"
        )
    pixels = max(tag.pixels for tag in tags)
    agree = f", which agree to {spread:.1%}" if len(tags) > 1 else ""
    reason = (
        f"tag {_listed([tag.number for tag in tags])} in {plural(int(shots.max()), 'shot')}"
        f"{agree}; corners off by {pixels:.2f} pixels"
    )
    return _ScaleBy(name="tag", scale=math.exp(middle), reason=reason)


def _by_camera_height(
    capture: Capture, options: AlignOptions, up: Values, floor: float | None, warnings: list[str]
) -> list[_ScaleBy]:
    if options.camera_height is None:
        return []
    if floor is None:
        warnings.append("no level floor was found, so that the cameras' height gives no scale")
        return []
    heights = np.einsum("ni,i->n", capture.centres, up) - floor
    height = float(np.median(heights))
    if height <= 0:
        raise UsageError(
            "half of the cameras are below the floor that was found",
            fix="give another cue for scale than camera_height",
        )
    low, high = np.quantile(heights, [0.1, 0.9]) / height * options.camera_height
    reason = f"median {options.camera_height:g} m; most cameras from {low:.2f} to {high:.2f} m"
    return [_ScaleBy(name="camera height", scale=options.camera_height / height, reason=reason)]


def _by_lengths(
    capture: Capture, options: AlignOptions, up: Values, *, vertical: bool
) -> list[_ScaleBy]:
    return [
        _ScaleBy(
            name="height" if vertical else "length",
            scale=length.metres / units_of(length, capture, up),
            reason=f"{length.metres:g} m between two points",
        )
        for length in options.lengths
        if length.vertical == vertical
    ]


def _by_poses(
    options: AlignOptions, positions: PositionFit | None, warnings: list[str]
) -> list[_ScaleBy]:
    answers: list[_ScaleBy] = []
    if options.metric:
        answers.append(_ScaleBy(name="poses", scale=1.0, reason="they come in metres"))
    if positions is not None:
        reason = (
            f"{plural(len(options.positions), 'shot')}, off by {positions.off:.3g} m; scale known "
            f"to {positions.uncertain:.1%}"
        )
        answers.append(_ScaleBy(name="positions", scale=positions.scale, reason=reason))
        if positions.uncertain > _VAGUE:
            warnings.append(
                f"the positions are off by {positions.off:.2g} m, so they know the scale to "
                f"{positions.uncertain:.0%} only"
            )
    return answers


def _nothing(capture: Capture, folder: Path, options: AlignOptions, warnings: list[str]) -> str:
    """Return that there is no scale, and which tags one need only measure."""
    text = "nothing says how long a unit of this capture is"
    if warnings:
        return f"{text}: {'; '.join(warnings)}"
    try:
        found = find_tags(capture, folder, options.tag_family, lambda _: None)
    except PrerequisiteError:
        return text
    seen = [number for number, where in found.items() if len(where) > 1]
    return f"{text}; tag {_listed(seen)} is in view, its edge is not known" if seen else text


def _listed(numbers: list[int]) -> str:
    return ", ".join(map(str, numbers))


def units_of(length: KnownLength, capture: Capture, up: Values) -> float:
    """Return how many of the capture's units a known length has.

    Args:
        length: with its two points.
        capture: in whose frame, or in whose shots, they are.
        up: (3,) unit vector, for heights.

    Raises:
        UsageError: a shot is not there, picks do not meet in a point, or the points coincide.
    """
    way = _point(length.second, capture) - _point(length.first, capture)
    units = abs(float(way @ up)) if length.vertical else float(np.linalg.norm(way))
    if units < 1e-9 * max(1.0, float(np.abs(capture.points).max(initial=0.0))):
        raise UsageError(
            f"the two points of a length of {length.metres:g} m coincide",
            fix="pick two points apart" + (" in height" if length.vertical else ""),
        )
    return units


def _point(where: Vector | Mapping[str, Pixel], capture: Capture) -> Values:
    if not isinstance(where, Mapping):
        return np.asarray(where, dtype=np.float64)
    shots = {shot.name: shot for shot in capture.shots}
    for name in where:
        if name not in shots:
            raise UsageError(
                f"a point was picked in {name!r}, which is no shot of the capture",
                fix=nearest(name, shots),
            )
    cameras = [shots[name].camera for name in where]
    pixels = np.array(list(where.values()), dtype=np.float64).reshape(-1, 1, 2)
    found = triangulate(cameras, pixels, tolerance=_TOLERANCE)
    if found is None:
        raise UsageError(
            f"the picks in {', '.join(where) or 'no shot'} do not meet in a point",
            fix="pick the same point in two shots or more, from places well apart",
        )
    return found.points[0]
