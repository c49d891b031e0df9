"""Up and the floor of a capture, and what each cue says of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.plural import plural
from nw_eval.twin.align.alignment import GravityCue
from nw_eval.twin.align.gravity.consensus import LEVEL, UPRIGHT, Consensus, consensus, smallest
from nw_eval.twin.align.gravity.floor import FloorLevel, doubt, find_floor, floor_of_mesh
from nw_eval.twin.align.gravity.horizon import Horizon, horizon, level_form, upright_form
from nw_eval.twin.align.gravity.planes import FittedPlane, find_planes
from nw_eval.twin.capture import Capture

Values = NDArray[np.float64]
Mesh = tuple[NDArray[np.floating], NDArray[np.integer]]
"""Vertices (V, 3) in the capture's frame, and faces (F, 3)."""

_TOLERANCE = 0.01
"""How far off a plane a point may be, of the distance from which it was photographed."""
_MESH = LEVEL / 4
"""Of a mesh's floor: what the points say is of the same floor, and of less of it."""
_LEAST_POINTS = 12
_SURE = 5.0
"""Degrees: cameras that know up worse than this are worth a word where no plane helps."""
_RAMP = 0.1
"""Share of points of a slope that is worth a word."""


@dataclass(frozen=True, kw_only=True)
class KnownUp:
    """Up as a source of poses has it.

    Attributes:
        name: of its cue.
        up: (3,) unit vector in the capture's frame.
        sigma: its standard deviation, radians.
        reason: for people.
    """

    name: str
    up: Values
    sigma: float
    reason: str


@dataclass(frozen=True, kw_only=True)
class GravityAnswer:
    """Up and the floor.

    Attributes:
        up: (3,) unit vector in the capture's frame.
        floor: height of the floor along it below the first camera, in the capture's unit.
        floor_share: of the points, which lies on it.
        has_floor: whether a level plane was found there; else it is as high as the lowest points.
        cues: what each says.
        warnings: what somebody should look at, disagreements aside.
    """

    up: Values
    floor: float
    floor_share: float
    has_floor: bool
    cues: tuple[GravityCue, ...]
    warnings: tuple[str, ...]


def find_gravity(
    capture: Capture,
    mesh: Mesh | None,
    known: Sequence[KnownUp],
    rng: np.random.Generator,
    say: Callable[[str], None],
) -> GravityAnswer:
    """Return up and the floor of a capture.

    Raises:
        SceneError: it has no shots, or too few points to find a floor in.
    """
    if not capture.shots or len(capture.points) < _LEAST_POINTS:
        raise SceneError(
            f"a capture with {plural(len(capture.shots), 'shot')} and "
            f"{plural(len(capture.points), 'point')} cannot be aligned",
            fix=f"calibrate it with more photographs: {_LEAST_POINTS} points at least",
        )
    poses = np.array([shot.camera.T_world_camera[:3, :3] for shot in capture.shots])
    level = horizon(poses / np.linalg.norm(poses[:, :, :1], axis=1, keepdims=True), rng)
    tolerance = _TOLERANCE * _distance(capture)
    planes = find_planes(capture.points, tolerance, rng)
    points, centres = capture.points, capture.centres
    doubts = [doubt(one, points, centres, level.up, 3.0 * tolerance) for one in planes]
    found = consensus(level, planes, doubts, [(one.up, one.sigma) for one in known])
    floor = find_floor(points, centres, found.up, found.level, tolerance)
    by_mesh = None
    up = found.up
    if mesh is not None:
        begin = floor.plane or FittedPlane(normal=up, offset=floor.height, share=0.0, sigma=0.0)
        vertices, faces = mesh
        by_mesh = floor_of_mesh(vertices.astype(np.float64), faces, begin, tolerance)
        if by_mesh is not None:
            sigma = math.hypot(_MESH, by_mesh.sigma)
            up = smallest(found.form + level_form(by_mesh.normal, sigma), up)
    for plane in planes:
        slope = math.degrees(math.acos(min(1.0, abs(float(plane.normal @ up)))))
        if plane.share > _RAMP and math.degrees(LEVEL) * 12 < slope < 40:
            say(f"a plane with {plane.share:.0%} of the points slopes by {slope:.1f} degrees")
    plane = by_mesh or floor.plane
    return GravityAnswer(
        up=up,
        floor=floor.height if plane is None else _below(centres[0], up, plane),
        floor_share=floor.share,
        has_floor=plane is not None,
        cues=_cues(up, level, found, floor, by_mesh, known),
        warnings=_warnings(level, floor, known),
    )


def _distance(capture: Capture) -> float:
    """Return the distance from which points are usually photographed."""
    centres = capture.centres
    seen = [
        float(np.median(np.linalg.norm(capture.points[shot.seen] - centre, axis=1)))
        for shot, centre in zip(capture.shots, centres, strict=True)
        if len(shot.seen)
    ]
    if not seen:
        away = np.linalg.norm(capture.points - centres.mean(axis=0), axis=1)
        return float(np.median(away))
    return float(np.median(seen))


def _below(centre: Values, up: Values, plane: FittedPlane) -> float:
    """Return the height of a plane along `up`, on the line below a camera."""
    drop = (float(plane.normal @ centre) - plane.offset) / float(plane.normal @ up)
    return float(centre @ up) - drop


def _cues(
    up: Values,
    level: Horizon,
    found: Consensus,
    floor: FloorLevel,
    by_mesh: FittedPlane | None,
    known: Sequence[KnownUp],
) -> tuple[GravityCue, ...]:
    lie = ", pictures on their sides" if level.sideways else ""
    reason = (
        f"the cameras' sideways axes, rolled by {level.roll:.1f} degrees{lie}; known to "
        f"{level.degrees:.1f} degrees"
    )
    cues = [_cue("horizon", level.up, up, math.radians(level.degrees), reason)]
    if floor.plane is not None:
        reason = f"a plane below the cameras with {floor.share:.0%} of the points"
        sigma = math.hypot(LEVEL, floor.plane.sigma)
        cues.append(_cue("floor", floor.plane.normal, up, sigma, reason))
    if found.walls:
        form = 1e-3 * level_form(level.up, UPRIGHT)
        for plane in found.walls:
            form = form + upright_form(plane.normal, math.hypot(UPRIGHT, plane.sigma))
        sigma = 1.0 / math.sqrt(float(np.linalg.eigvalsh(form)[1]))
        reason = f"{plural(len(found.walls), 'upright plane')}"
        cues.append(_cue("walls", smallest(form, up), up, sigma, reason))
    if by_mesh is not None:
        reason = f"the mesh's faces along the floor, {by_mesh.share:.0%} of its area"
        cues.append(_cue("mesh", by_mesh.normal, up, math.hypot(LEVEL, by_mesh.sigma), reason))
    cues += [_cue(one.name, one.up, up, one.sigma, one.reason) for one in known]
    return tuple(cues)


def _cue(name: str, own: Values, up: Values, sigma: float, reason: str) -> GravityCue:
    own = own / np.linalg.norm(own)
    sine = float(np.linalg.norm(np.cross(own, up)))
    x, y, z = own.tolist()
    return GravityCue(
        name=name,
        up=(x, y, z),
        degrees=math.degrees(math.atan2(sine, float(own @ up))),
        uncertain=math.degrees(sigma),
        reason=reason,
    )


def _warnings(level: Horizon, floor: FloorLevel, known: Sequence[KnownUp]) -> tuple[str, ...]:
    warnings: list[str] = []
    if floor.plane is None:
        warnings.append(
            "no level plane lies below the cameras with little below it: the floor's height is "
            "that of the lowest points. Does the floor mirror, or has it no texture? Lay something "
            "matt with a pattern on it, and photograph again"
        )
        if level.degrees > _SURE and not known:
            warnings.append(
                f"up is known to {level.degrees:.0f} degrees only: all cameras look one way"
            )
    if level.sideways:
        warnings.append("the pictures seem to lie on their sides: check which way is up")
    return tuple(warnings)
