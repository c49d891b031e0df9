"""Aligning a capture: up by consensus, scale by a tag or what else is known, the floor at z = 0.

Scale, how long a unit of a capture is, is by every cue that there is, the most trusted first.
Lengths and heights that somebody measured lie between points in space, or points picked in shots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PrerequisiteError, UsageError, nearest
from nw_base.plural import plural
from nw_base.words import UpAxis
from nw_scenes.rays import RayScene
from nw_scenes.scene import Vector
from nw_twin.align.alignment import (
    CARRIED,
    MOST_DEGREES,
    MOST_DIFFERENCE,
    Alignment,
    AlignOptions,
    GravityCue,
    KnownLength,
    Pixel,
    ScaleCue,
    check_inside,
    placed,
    words_of,
)
from nw_twin.align.gravity import Mesh, find_gravity
from nw_twin.align.positions import PositionFit, fit_positions
from nw_twin.align.tags import FAMILY, PlacedTag, find_tags, place_tags, triangulate
from nw_twin.align.up import KnownUp
from nw_twin.capture import Capture, PlacedShot
from nw_twin.place import moved_mesh

_VAGUE = 0.02
"""A scale by positions that is known worse is worth a word."""
_ROUGH = 0.03
"""A scale by a length that a pixel changes by more is worth a word."""
_USELESS = 0.15
"""A scale that is known worse is none: it is compared with others."""
_TAG, _LENGTH, _HEIGHT, _POSES = 0.01, 0.01, 0.06, 0.02
"""Relative standard deviations of an edge and a length that somebody measured, of the height at
which somebody says that a camera was held, and of a phone's tracking."""
_CONTRADICT = 3.0
"""Standard deviations of their difference from which on two sources contradict each other."""
_NINE_OF_TEN = 1.645
"""Standard deviations within which a scale lies nine times out of ten."""
_TOLERANCE = 8.0
"""Pixels that a picked point may be off: hands are less exact than detectors."""


@dataclass(frozen=True, kw_only=True)
class ScaleAnswer:
    """Metres in a unit, each cue's answer, and what somebody should look at.

    Where no cue is used nothing gives a scale: `scale` is such that the cameras are `CARRIED` above
    the floor, and `uncertain` is None.
    """

    scale: float
    cues: tuple[ScaleCue, ...]
    warnings: tuple[str, ...]
    uncertain: float | None = None


@dataclass(frozen=True, kw_only=True)
class _ScaleBy:
    name: str
    scale: float
    sigma: float
    reason: str

    def contradicts(self, other: _ScaleBy) -> bool:
        apart = abs(math.log(self.scale / other.scale))
        return apart > _CONTRADICT * math.hypot(self.sigma, other.sigma)

    def __str__(self) -> str:
        known = f"known to {min(_NINE_OF_TEN * self.sigma, 9.99):.0%}"
        return f"{self.name} says {self.scale:.3g} m a unit, {known}"


def find_scale(
    capture: Capture,
    folder: Path | None,
    options: AlignOptions,
    *,
    heights: Values,
    lower: float,
    has_floor: bool,
    surface: RayScene | None,
    positions: PositionFit | None,
    say: Callable[[str], None],
) -> ScaleAnswer:
    """Return the scale by the source that is known best: tags, lengths, height, poses, positions.

    Where two contradict each other by more than both claim, and no third decides, there is none.

    Args:
        capture: with its pictures in `folder`.
        folder: of the capture; None = its pictures are not looked at.
        options: what somebody knows.
        heights: (V,) of the cameras above the floor, in the capture's unit.
        lower: share of their height by which the lowest points lie below the floor.
        has_floor: whether a plane was found for a floor.
        surface: mesh on which points lie that were picked in one photograph; None without.
        positions: the fit to known positions; None without.
        say: receives the tags that are found.

    Raises:
        UsageError: a point of a length is in no photograph, or does not meet the surface.
        PrerequisiteError: what finds tags is not installed.
        SceneError: a picture cannot be read.
    """
    warnings: list[str] = []
    answers = [
        *_by_tags(capture, folder, options, warnings, say),
        *_by_lengths(capture, options, surface, warnings),
        *_by_camera_height(options, heights if has_floor else None, lower, warnings),
        *_by_poses(options, positions, warnings),
    ]
    best = _best(answers, warnings)
    if best is None:
        warnings.append(_nothing(capture, folder, options))
        own = _own_unit(capture, heights)
        return ScaleAnswer(scale=own, cues=_scale_cues(answers, None), warnings=tuple(warnings))
    return ScaleAnswer(
        scale=best.scale,
        cues=_scale_cues(answers, best),
        warnings=tuple(warnings),
        uncertain=_NINE_OF_TEN * best.sigma,
    )


def _best(answers: list[_ScaleBy], warnings: list[str]) -> _ScaleBy | None:
    """Return the source that is known best of those that most others agree with; None without."""

    def votes(one: _ScaleBy) -> int:
        return sum(-1 if one.contradicts(other) else 1 for other in answers if other is not one)

    usable = [one for one in answers if one.sigma <= _USELESS]
    best = max(usable, key=lambda one: (votes(one), -one.sigma), default=None)
    if best is None:
        return None
    against = [one for one in answers if best.contradicts(one)]
    if not against:
        return best
    which = "; ".join(map(str, [best, *against]))
    if votes(best) >= 0:  # Two against one, itself counted.
        warnings.append(f"sources of the scale contradict each other: {which}. The first is used")
        return best
    warnings.append(
        f"the scale is not known, since its sources contradict each other: {which}. Give another "
        "length (--length A B METRES), or leave the wrong one out"
    )
    return None


def _scale_cues(answers: list[_ScaleBy], best: _ScaleBy | None) -> tuple[ScaleCue, ...]:
    """Return what each source says, the one that is used first."""
    ordered = sorted(answers, key=lambda one: one is not best)
    return tuple(
        ScaleCue(
            name=one.name,
            scale=one.scale,
            difference=one.scale / ordered[0].scale - 1.0,
            used=one is best,
            uncertain=_NINE_OF_TEN * one.sigma,
            reason=one.reason,
        )
        for one in ordered
    )


def _by_tags(
    capture: Capture,
    folder: Path | None,
    options: AlignOptions,
    warnings: list[str],
    say: Callable[[str], None],
) -> list[_ScaleBy]:
    if folder is None or options.tag_edge is None:
        return []
    sightings = find_tags(capture, folder, say)
    tags = place_tags(capture, sightings)
    lost = sorted(sightings.keys() - {tag.number for tag in tags})
    if lost:
        warnings.append(f"no two shots agree on where these tags are: {_listed(lost)}")
    if not tags:
        if not lost:
            warnings.append(f"no {FAMILY} tag of known edge is in any picture")
        return []
    return [_tag_answer(tags, options.tag_edge, warnings)]


def _tag_answer(tags: list[PlacedTag], edge: float, warnings: list[str]) -> _ScaleBy:
    """Return the mean of the tags' scales, each as often as shots agree on it."""
    logs = np.array([math.log(edge / tag.edge) for tag in tags])
    shots = np.array([tag.shots for tag in tags])
    middle = float((shots * logs).sum() / shots.sum())
    spread = float(np.abs(np.expm1(logs - middle)).max())
    if spread > MOST_DIFFERENCE:
        worst = tags[int(np.argmax(np.abs(logs - middle)))].number
        warnings.append(
            f"the tags disagree by {spread:.1%} about the scale, tag {worst} most: is its edge "
            f"{edge:g} m?"
        )
    pixels = max(tag.pixels for tag in tags)
    agree = f", which agree to {spread:.1%}" if len(tags) > 1 else ""
    reason = (
        f"tag {_listed([tag.number for tag in tags])} in {plural(int(shots.max()), 'shot')}"
        f"{agree}; corners off by {pixels:.2f} pixels"
    )
    sigma = math.hypot(_TAG, spread)
    return _ScaleBy(name="tag", scale=math.exp(middle), sigma=sigma, reason=reason)


def _by_camera_height(
    options: AlignOptions, heights: Values | None, lower: float, warnings: list[str]
) -> list[_ScaleBy]:
    if options.camera_height is None:
        return []
    if heights is None:
        warnings.append("no level floor was found, so that the cameras' height gives no scale")
        return []
    height = float(np.median(heights))
    if height <= 0:
        warnings.append(
            "half of the cameras are below the floor that was found, so that their height gives "
            "no scale"
        )
        return []
    low, high = np.quantile(heights, [0.1, 0.9]) / height * options.camera_height
    reason = f"median {options.camera_height:g} m; most cameras from {low:.2f} to {high:.2f} m"
    sigma = math.hypot(_HEIGHT, math.log1p(lower))
    if sigma > _USELESS:
        warnings.append(
            f"points lie {lower:.0%} of the cameras' height below the floor that was found, which "
            "may be a ledge, so that their height gives no scale"
        )
    scale = options.camera_height / height
    return [_ScaleBy(name="camera height", scale=scale, sigma=sigma, reason=reason)]


def _by_lengths(
    capture: Capture,
    options: AlignOptions,
    surface: RayScene | None,
    warnings: list[str],
) -> list[_ScaleBy]:
    answers: list[_ScaleBy] = []
    for length in options.lengths:
        units = units_of(length, capture, surface)
        ends = f"{words_of(length.first)} and {words_of(length.second)}"
        reason, off = f"{length.metres:g} m between {ends}", _by_a_pixel(length, capture, surface)
        if off is not None:
            reason += f"; known to {off / units:.1%} where each pixel is off by one"
            if off > _ROUGH * units:
                warnings.append(
                    f"the length between {ends} is known to {off / units:.0%} only: pick points "
                    "nearer to the camera and farther apart, in photographs taken well apart"
                )
        sigma = math.hypot(_LENGTH, 0.0 if off is None else off / units)
        scale = length.metres / units
        answers.append(_ScaleBy(name="length", scale=scale, sigma=sigma, reason=reason))
    return answers


def _by_a_pixel(length: KnownLength, capture: Capture, surface: RayScene | None) -> float | None:
    """Return by how much a length is off where each picked pixel is off by one; None without."""
    units = units_of(length, capture, surface)
    squares: list[float] = []
    for which in ("first", "second"):
        end = getattr(length, which)
        if not isinstance(end, Mapping):
            return None
        for name, (x, y) in end.items():
            for moved in ((x - 1.0, y), (x, y - 1.0)):
                try:
                    other = replace(length, **{which: {**end, name: moved}})
                    squares.append((units_of(other, capture, surface) - units) ** 2)
                except UsageError:  # Off the picture, or into a hole.
                    continue
    return math.sqrt(sum(squares))


def _own_unit(capture: Capture, heights: Values) -> float:
    """Return the scale at which cameras are as high above the floor as people carry them."""
    height = float(np.median(heights))
    if height <= 0:  # No floor either: what they look at is twice as far.
        away = np.linalg.norm(capture.points - np.median(capture.centres, axis=0), axis=1)
        height = float(np.median(away)) / 2.0
    return CARRIED / height if height > 0 else 1.0


def _by_poses(
    options: AlignOptions, positions: PositionFit | None, warnings: list[str]
) -> list[_ScaleBy]:
    answers: list[_ScaleBy] = []
    if options.metric:
        reason = "they come in metres"
        answers.append(_ScaleBy(name="poses", scale=1.0, sigma=_POSES, reason=reason))
    if positions is None or not positions.scale > 0:
        return answers
    known = f"the positions{' (GPS)' if options.positions_error else ''} are off by"
    sigma, off = positions.uncertain, max(positions.off, options.positions_error)
    reason = (
        f"{plural(len(options.positions), 'shot')}, off by {off:.3g} m; scale known to {sigma:.1%}"
    )
    answers.append(_ScaleBy(name="positions", scale=positions.scale, sigma=sigma, reason=reason))
    if sigma > _USELESS:
        warnings.append(
            f"{known} {off:.2g} m, so they know the scale to {sigma:.0%} only, which is none: the "
            "photographs lie too near together"
        )
    elif sigma > _VAGUE:
        warnings.append(f"{known} {off:.2g} m, so they know the scale to {sigma:.0%} only")
    return answers


def _nothing(capture: Capture, folder: Path | None, options: AlignOptions) -> str:
    """Return that there is no scale, and which tags one need only measure."""
    text = (
        "nothing gives a scale: the scene is in a unit of its own, in which the cameras are "
        f"{CARRIED:g} above the floor"
    )
    if folder is None or options.tag_edge is not None:
        return text
    try:
        sightings = find_tags(capture, folder, lambda _: None)
    except PrerequisiteError:
        return text
    seen = [number for number, where in sightings.items() if len(where) > 1]
    return f"{text}; tag {_listed(seen)} is in view, its edge is not known" if seen else text


def _listed(numbers: list[int]) -> str:
    return ", ".join(map(str, numbers))


def units_of(length: KnownLength, capture: Capture, surface: RayScene | None = None) -> float:
    """Return how many of the capture's units a known length has.

    Args:
        length: with its two points.
        capture: in whose frame, or in whose shots, they are.
        surface: mesh on which points lie that were picked in one shot; None without.

    Raises:
        UsageError: a shot is not there, a pick does not meet the mesh, picks do not meet in a
            point, or the points coincide.
    """
    first, second = (_point(end, capture, surface) for end in (length.first, length.second))
    units = float(np.linalg.norm(second - first))
    if units < 1e-9 * max(1.0, float(np.abs(capture.points).max(initial=0.0))):
        raise UsageError(
            f"the two points of a length of {length.metres:g} m coincide",
            fix="pick two points apart",
        )
    return units


def _point(
    where: Vector | Mapping[str, Pixel], capture: Capture, surface: RayScene | None
) -> Values:
    if not isinstance(where, Mapping):
        return np.asarray(where, dtype=np.float64)
    shots = {shot.name: shot for shot in capture.shots}
    for name in where:
        if name not in shots:
            raise UsageError(
                f"a point was picked in {name!r}, which is not a shot of the capture",
                fix=nearest(name, shots),
            )
    chosen = [shots[name] for name in where]
    pixels = np.array([_in_picture(shots[name], pixel) for name, pixel in where.items()])
    if len(chosen) == 1:
        return _on_mesh(chosen[0], pixels[0], words_of(where), surface)
    triangulated = triangulate(
        [one.camera for one in chosen], pixels[:, None], tolerance=_TOLERANCE
    )
    if triangulated is None:
        raise UsageError(
            f"the picks {words_of(where) or 'in no shot'} do not meet in a point",
            fix="pick the same point in two shots or more, taken well apart",
        )
    return triangulated.points[0]


def _in_picture(shot: PlacedShot, pixel: Pixel) -> Values:
    """Return where the picture of a shot shows what its photograph does at a pixel, (2,)."""
    camera, lens = shot.camera, shot.lens
    check_inside(shot.name, pixel, shot.photographed)
    if lens is None:
        return np.array(pixel)
    x, y = np.asarray(lens.camera().cam_from_img(np.array([pixel], dtype=np.float64)))[0, :2]
    return np.array([camera.fx * x + camera.cx, camera.fy * y + camera.cy])


def _on_mesh(shot: PlacedShot, pixel: Values, text: str, surface: RayScene | None) -> Values:
    """Return where the ray of a picture's pixel meets the mesh, in the capture's frame."""
    two = "give the point in two photographs that show it, IMG_1.jpg:412,310+IMG_2.jpg:97,305"
    if surface is None:
        raise UsageError(f"{text} is in one photograph, and there is no mesh", fix=two)
    camera = shot.camera
    local = [(pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy, 1.0]
    direction = np.einsum("ij,j->i", camera.T_world_camera[:3, :3], np.array(local))
    direction = direction / np.linalg.norm(direction)
    origin = camera.T_world_camera[:3, 3]
    distance, face = surface.cast(origin[None], direction[None])
    if face[0] < 0:
        raise UsageError(
            f"the point {text} does not meet the surface: the mesh has a hole there, or the "
            "pixel shows the sky",
            fix=f"pick a pixel of ground or of a large object nearby, or {two}",
        )
    return origin + float(distance[0]) * direction


Values = NDArray[np.float64]

_SOURCE = math.radians(0.5)
"""How well a phone knows gravity."""
_MOST_TURNED = math.radians(3.0)
"""Positions that lie along a line know up worse than this, and do not say."""


def align(
    capture: Capture,
    capture_folder: Path | None,
    mesh: Mesh | None = None,
    options: AlignOptions | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Alignment:
    """Return the similarity from a capture's frame to metres: z up, the floor at z = 0.

    The same capture in any other rotation, scale and place gives the same metric scene.

    Args:
        capture: as calibrated.
        capture_folder: with its pictures, in which upright edges and tags are looked for; None =
            they are not looked at.
        mesh: vertices (V, 3) in the capture's frame and faces (F, 3); it makes the floor exact.
        options: what no photograph tells; None = nothing is known, which gives no scale: the frame
            is then in a unit of its own, see `Alignment.is_to_scale`.
        say: receives how far it has come.

    Raises:
        UsageError: an option makes no sense.
        SceneError: the capture has too few points, or a picture cannot be read.
        PrerequisiteError: what finds tags is not installed.
    """
    options = AlignOptions() if options is None else options
    rng = np.random.default_rng(options.seed)
    positions = _positions(capture, options, rng)
    gravity = find_gravity(capture, mesh, _known(options, positions), rng, say, capture_folder)
    for cue in gravity.cues:
        say(
            f"up by {cue.name}: {cue.degrees:.2f} degrees from the chosen one, uncertain by "
            f"{cue.uncertain:.1f}; {cue.reason}"
        )
    others = {cue.name for cue in gravity.cues} - {"horizon", "mesh"}
    alone = f": by the cameras and the {min(others)} alone" if len(others) == 1 else ""
    say(f"up is known to {gravity.uncertain:.1f} degrees (95 %){alone}")
    scale = find_scale(
        capture,
        capture_folder,
        options,
        heights=gravity.heights,
        lower=gravity.lower,
        has_floor=gravity.has_floor,
        surface=None
        if mesh is None or not options.lengths
        else RayScene(moved_mesh(np.eye(4), *mesh)),
        positions=positions,
        say=say,
    )
    for cue in scale.cues:
        used = "used" if cue.used else "not used"
        if scale.cues[0].used and not cue.used:
            used = f"{cue.difference:+.1%}"
        say(f"scale by {cue.name}: {cue.scale:.5g} m, {used}; {cue.reason}")
    if scale.uncertain is not None:
        say(f"the scale is known to {scale.uncertain:.1%}, nine times out of ten")
    warnings = (
        *gravity.warnings,
        *scale.warnings,
        *_disagreements(gravity.cues, scale.cues),
    )
    for warning in warnings:
        say(f"warning: {warning}")
    return Alignment(
        T_metric_capture=placed(
            up=gravity.up,
            scale=scale.scale,
            floor=gravity.floor,
            centres=capture.centres,
            forward=capture.shots[0].camera.T_world_camera[:3, 2],
        ),
        scale=scale.scale,
        gravity=gravity.cues,
        scales=scale.cues,
        floor_share=gravity.floor_share,
        warnings=warnings,
        up_uncertain=gravity.uncertain,
        scale_uncertain=scale.uncertain,
    )


def _positions(
    capture: Capture, options: AlignOptions, rng: np.random.Generator
) -> PositionFit | None:
    if not options.positions:
        return None
    places = {shot.name: index for index, shot in enumerate(capture.shots)}
    known = [name for name in options.positions if name in places]
    if not known:
        name = next(iter(options.positions))
        raise UsageError(
            f"none of {len(options.positions)} positions is of a shot of the capture: {name!r}",
            fix=nearest(name, places),
        )
    rows = [places[name] for name in known]
    metres = np.array([options.positions[name] for name in known], dtype=np.float64)
    return fit_positions(capture.centres[rows], metres, rng, error=options.positions_error)


def _known(options: AlignOptions, positions: PositionFit | None) -> list[KnownUp]:
    known: list[KnownUp] = []
    if options.up is not None:
        reason = f"{options.up} is up, by their source"
        up = _axis(options.up)
        known.append(KnownUp(name="poses", up=up, sigma=_SOURCE, right=0.98, reason=reason))
    if positions is not None and options.positions_up is not None:
        up = positions.rotation.T @ _axis(options.positions_up)
        if positions.turned <= _MOST_TURNED:
            reason = f"known to {math.degrees(positions.turned):.1f} degrees"
            sigma = math.hypot(_SOURCE, positions.turned)
            known.append(KnownUp(name="positions", up=up, sigma=sigma, reason=reason))
    return known


def _axis(name: UpAxis) -> Values:
    axis = np.zeros(3)
    axis["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return axis


def _disagreements(gravity: tuple[GravityCue, ...], scales: tuple[ScaleCue, ...]) -> list[str]:
    return [
        f"up by {cue.name} is {cue.degrees:.1f} degrees off ({cue.reason})"
        for cue in gravity
        if cue.degrees > max(MOST_DEGREES, 2.0 * cue.uncertain)
    ] + [
        f"the scale by {cue.name} differs by {cue.difference:+.1%} from that by {scales[0].name}"
        for cue in scales
        if scales[0].used and abs(cue.difference) > MOST_DIFFERENCE
    ]
