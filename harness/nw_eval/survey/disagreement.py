"""How far a splat lies off the mesh, and in which direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ENOUGH = 300  # pixels that a direction is judged by
_ALIKE = 0.9  # cosine of the angle up to which a surface faces along an axis
_GRAZED = 0.1  # cosine below which a surface is seen too flatly to be judged
_OTHER = 0.6  # m; what is farther off is something else
_HEIGHTS_FIRST = 0.05  # m; beyond it other edges are in view, and tell nothing of the sides
_AGREED = 0.05  # m, within which half of what moved as one lies


@dataclass(frozen=True, kw_only=True, eq=False)
class Residuals:
    """Pixels in which both splat and mesh show something.

    Attributes:
        off: (N,) m from the mesh to the splat along the surface's normal; positive = towards the
            camera.
        normals: (N, 3) of the mesh there, world, towards the camera.
        facing: (N,) cosine of the angle between normal and ray.
        course: (N,) whether the place is on the course: near the trail, and neither high nor deep.
        built: (N,) whether it is on the course, or of what was dug into it.
    """

    off: Values
    normals: Values
    facing: Values
    course: Mask
    built: Mask

    @classmethod
    def joined(cls, parts: Sequence[Residuals]) -> Residuals:
        """Return the pixels of several views as one."""
        return cls(
            off=np.concatenate([part.off for part in parts]),
            normals=np.concatenate([part.normals for part in parts]),
            facing=np.concatenate([part.facing for part in parts]),
            course=np.concatenate([part.course for part in parts]),
            built=np.concatenate([part.built for part in parts]),
        )


@dataclass(frozen=True, kw_only=True)
class Disagreement:
    """How a splat and a mesh differ.

    Attributes:
        median, p95: distance of the splat from the mesh's surface on the course, m; None where
            the course is not in view.
        shift: (3,) where the splat lies from the mesh, world, m: 0 along what no surface faces.
        shifts_as_one: whether all that faces each way is shifted alike: then moving the splat by
            the opposite mends it.
    """

    median: float | None
    p95: float | None
    shift: tuple[float, float, float]
    shifts_as_one: bool


def disagreement(pixels: Residuals) -> Disagreement:
    """Return how far splat and mesh are apart.

    Depth alone is blind to a splat that slides along a floor. Surfaces that face other ways tell:
    what stands across the way, and walls on either side, whose common bias towards the camera
    cancels. What faces one way alone is believed where it agrees with itself, or is of the course.
    """
    there = np.abs(pixels.off[pixels.course])
    use = (np.abs(pixels.off) < _OTHER) & (pixels.facing > _GRAZED)
    off, normals = pixels.off[use], pixels.normals[use]
    course, built = pixels.course[use], pixels.built[use]
    axes = _axes(normals, pixels.facing[use])
    shift = np.zeros(3)
    as_one = True
    for axis, upright in zip(axes, (False, False, True), strict=True):
        along = normals @ axis
        sides = [sign * along > _ALIKE for sign in (1.0, -1.0)]
        if upright:
            # Of ceilings the robot sees little; ground tells heights by itself.
            sides = [side & course for side in sides]
        elif min(int(side.sum()) for side in sides) < _ENOUGH:
            sides = [side if _agree(off[side]) else side & built for side in sides]
        found = [
            (sign, off[side])
            for sign, side in zip((1.0, -1.0), sides, strict=True)
            if side.sum() >= _ENOUGH
        ]
        if not found:
            continue
        if len(found) == 1 or upright:
            sign, alone = max(found, key=lambda each: len(each[1]))
            middle, width = _most(alone)
            moved = sign * middle
            as_one &= width < _AGREED
        else:
            moved = sum(sign * float(np.median(side)) for sign, side in found) / 2
        shift += moved * axis
    if abs(shift[2]) > _HEIGHTS_FIRST:
        shift[:2] = 0.0
    x, y, z = shift.tolist()
    return Disagreement(
        median=float(np.median(there)) if there.size else None,
        p95=float(np.quantile(there, 0.95)) if there.size else None,
        shift=(x, y, z),
        shifts_as_one=bool(as_one),
    )


def _axes(normals: Values, weights: Values) -> Values:
    """Return the two level directions along which upright surfaces mostly face, and up; (3, 3)."""
    upright = np.abs(normals[:, 2]) < 0.4
    # Walls at right angles to each other have one angle when it is taken four times.
    fourfold = (normals[upright, 0] + 1j * normals[upright, 1]) ** 4 * weights[upright]
    turn = float(np.angle(fourfold.sum())) / 4
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _agree(values: Values) -> bool:
    return len(values) >= _ENOUGH and _most(values)[1] < _AGREED


def _most(values: Values) -> tuple[float, float]:
    """Return the middle and the width of the shortest interval that holds half of the values.

    What an edge hides or uncovers spoils a median, but does not gather anywhere.
    """
    ordered = np.sort(values)
    half = len(ordered) // 2
    widths = ordered[half:] - ordered[: len(ordered) - half]
    first = int(np.argmin(widths))
    return float(ordered[first] + ordered[first + half]) / 2, float(widths[first])
