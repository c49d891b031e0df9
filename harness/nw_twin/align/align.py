"""Aligning a capture: up and scale by all that is known of them, the floor at z = 0.

Lengths and heights that somebody measured lie between points in space, or points picked in shots.
`scale.py` weighs what gives a scale.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PrerequisiteError, SceneError, UsageError, nearest
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
from nw_twin.align.gravity import GravityAnswer, Mesh, find_gravity
from nw_twin.align.positions import PositionFit, fit_positions
from nw_twin.align.scale import ScaleSource, solve_scale
from nw_twin.align.tags import FAMILY, PlacedTag, find_tags, place_tags, triangulate
from nw_twin.align.up import KnownUp
from nw_twin.capture import Capture, PlacedShot
from nw_twin.place import moved_mesh

_ROUGH = 0.03
"""A scale by a length that a pixel changes by more is worth a word."""
_USELESS = 0.15
"""Relative standard deviation of a source that a user has to know to be next to none."""
_LOOSEST = 0.35
"""A scale that is known worse, with 95 %, is none."""
_TAG, _LENGTH, _HEIGHT, _POSES = 0.01, 0.01, 0.06, 0.02
"""Relative standard deviations of an edge and a length that somebody measured, of the height at
which somebody says that a camera was held, and of a phone's tracking."""
_LEVEL = 2.0
"""Degrees by which a floor slopes at most, for the cameras' height over it to give a scale."""
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


def find_scale(
    capture: Capture,
    folder: Path | None,
    options: AlignOptions,
    *,
    gravity: GravityAnswer,
    surface: RayScene | None,
    positions: PositionFit | None,
    say: Callable[[str], None],
) -> ScaleAnswer:
    """Return the scale by all sources: tags, lengths, the cameras' height, poses, positions.

    Args:
        capture: with its pictures in `folder`.
        folder: of the capture; None = its pictures are not looked at.
        options: what somebody knows.
        gravity: up and the floor.
        surface: mesh on which points lie that were picked in one photograph; None without.
        positions: the fit to known positions; None without.
        say: receives the tags that are found.

    Raises:
        UsageError: a point of a length is in no photograph, or does not meet the surface.
        PrerequisiteError: what finds tags is not installed.
        SceneError: a picture cannot be read; or sources contradict each other, and no further one
            says which is wrong.
    """
    warnings: list[str] = []
    sources = [
        *_by_tags(capture, folder, options, warnings, say),
        *_by_lengths(capture, options, surface, warnings),
        *_by_camera_height(options, gravity, warnings),
        *_by_poses(options, positions, warnings),
    ]
    sources.sort(key=lambda one: one.sigma)
    answer = solve_scale(sources) if sources else None
    if answer is not None and answer.disputed:
        raise SceneError(
            "the scale is not known, since its sources contradict each other: "
            + "; ".join(str(sources[i]) for i in answer.disputed),
            fix="measure one more length and give it (--length A B METRES), or correct the option "
            "that is wrong",
        )
    if answer is None or answer.within > _LOOSEST:
        warnings.append(_nothing(capture, folder, options))
        own = _own_unit(capture, gravity.heights)
        return ScaleAnswer(scale=own, cues=_cues(sources, own), warnings=tuple(warnings))
    warnings += [
        f"{sources[i]}: the others contradict it, and it is not used" for i in answer.wrong
    ]
    return ScaleAnswer(
        scale=answer.scale,
        cues=_cues(sources, answer.scale, set(range(len(sources))) - set(answer.wrong)),
        warnings=tuple(warnings),
        uncertain=answer.within,
    )


def _cues(
    sources: list[ScaleSource], scale: float, used: AbstractSet[int] = frozenset()
) -> tuple[ScaleCue, ...]:
    """Return what each source says, those that are used first."""
    return tuple(
        ScaleCue(
            name=sources[i].name,
            scale=sources[i].scale,
            difference=sources[i].scale / scale - 1.0,
            used=i in used,
            uncertain=sources[i].within,
            reason=sources[i].reason,
        )
        for i in sorted(range(len(sources)), key=lambda i: i not in used)
    )


def _by_tags(
    capture: Capture,
    folder: Path | None,
    options: AlignOptions,
    warnings: list[str],
    say: Callable[[str], None],
) -> list[ScaleSource]:
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


def _tag_answer(tags: list[PlacedTag], edge: float, warnings: list[str]) -> ScaleSource:
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
    return ScaleSource(name="tag", scale=math.exp(middle), sigma=sigma, reason=reason)


def _by_camera_height(
    options: AlignOptions, gravity: GravityAnswer, warnings: list[str]
) -> list[ScaleSource]:
    """Return the scale by the cameras' height above a floor that was seen; empty without one."""
    if options.camera_height is None:
        return []
    height, why = float(np.median(gravity.heights)), None
    sigma = math.hypot(_HEIGHT, math.log1p(gravity.lower))
    if not gravity.has_floor:
        why = "no level floor was found"
    elif height <= 0:
        why = "half of the cameras are below the floor that was found"
    elif gravity.slope > _LEVEL:
        why = f"the floor that was found slopes by {gravity.slope:.1f} degrees"
    elif sigma > _USELESS:
        why = (
            f"points lie {gravity.lower:.0%} of the cameras' height below the floor that was found,"
            " which may be a ledge"
        )
    if why is not None:
        warnings.append(f"{why}, so that the cameras' height gives no scale")
        return []
    low, high = np.quantile(gravity.heights, [0.1, 0.9]) / height * options.camera_height
    reason = f"median {options.camera_height:g} m; most cameras from {low:.2f} to {high:.2f} m"
    scale = options.camera_height / height
    return [ScaleSource(name="camera height", scale=scale, sigma=sigma, reason=reason)]


def _by_lengths(
    capture: Capture,
    options: AlignOptions,
    surface: RayScene | None,
    warnings: list[str],
) -> list[ScaleSource]:
    answers: list[ScaleSource] = []
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
        answers.append(ScaleSource(name="length", scale=scale, sigma=sigma, reason=reason))
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
) -> list[ScaleSource]:
    answers: list[ScaleSource] = []
    if options.metric:
        reason = "they come in metres"
        answers.append(ScaleSource(name="poses", scale=1.0, sigma=_POSES, reason=reason))
    if positions is None or not positions.scale > 0:
        return answers
    sigma = math.hypot(positions.uncertain, 0.0 if options.positions_error else _POSES)
    off = max(positions.off, options.positions_error)
    reason = (
        f"{plural(len(options.positions), 'shot')}, off by {off:.3g} m; scale known to {sigma:.1%}"
    )
    answers.append(ScaleSource(name="positions", scale=positions.scale, sigma=sigma, reason=reason))
    if sigma > _USELESS:
        warnings.append(
            f"positions{' (GPS)' if options.positions_error else ''} that are off by {off:.2g} m "
            f"know the scale to {1.96 * sigma:.0%} only: the photographs lie too near together"
        )
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
        SceneError: the capture has too few points, a picture cannot be read, or sources of the
            scale contradict each other.
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
        gravity=gravity,
        surface=None
        if mesh is None or not options.lengths
        else RayScene(moved_mesh(np.eye(4), *mesh)),
        positions=positions,
        say=say,
    )
    for cue in scale.cues:
        used = f"{cue.difference:+.1%}" if cue.used else "not used"
        say(
            f"scale by {cue.name}: {cue.scale:.5g} m, {used}, known to "
            f"{min(cue.uncertain or 0.0, 9.99):.0%}; {cue.reason}"
        )
    if scale.uncertain is not None:
        say(f"scale: {scale.scale:.5g} m a unit, known to {scale.uncertain:.1%} (95 %)")
    warnings = (
        *gravity.warnings,
        *scale.warnings,
        *_disagreements(gravity.cues),
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


def _disagreements(gravity: tuple[GravityCue, ...]) -> list[str]:
    return [
        f"up by {cue.name} is {cue.degrees:.1f} degrees off ({cue.reason})"
        for cue in gravity
        if cue.degrees > max(MOST_DEGREES, 2.0 * cue.uncertain)
    ]
