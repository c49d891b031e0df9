"""The ground where feet go: what the mesh shows there, and what physics has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.scenes.scene import Scene, Triangles
from nw_eval.sim.binding import mujoco
from nw_eval.sim.geometry import add_geometry
from nw_eval.survey.samples import TrailSamples, trail_samples

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

Flaw = Literal["missing", "untouched", "unseen"]
"""Of ground: there is none; it is seen and nothing is there to be touched; or the other way."""

SPACING = 0.02
"""Between samples, along the trail and across it, m: as far as a foot's radius."""
WANDER = 0.1
"""How far to each side of the trail a robot's feet are beside their usual place, m."""
TOLERANCE = 0.05
"""By which heights of mesh and physics may differ, m."""

_BEHIND = 0.3  # m that the hind feet are behind the start, and its jitter
_MOST = 20_000  # samples along a trail
_DEEP = 1.0  # m below the trail: nobody walks there
_APART = 0.2  # m between flaws that are two


@dataclass(frozen=True, kw_only=True)
class GroundFlaw:
    """A stretch of the corridor whose ground is not what it should be.

    Attributes:
        kind: what is wrong.
        first, last: where, m along the trail.
        width: of the flaw where it is widest, m.
        area: m2.
        off: by how much the heights of mesh and physics differ there at most, m; None where one of
            them has none.
        across: whether it takes the whole corridor.
        place: its middle, world, m.
    """

    kind: Flaw
    first: float
    last: float
    width: float
    area: float
    off: float | None
    across: bool
    place: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class SurveyedGround:
    """The corridor under the feet.

    Attributes:
        width: m.
        sound: share of its samples at which mesh and physics have the same ground.
        flaws: in the order of the trail; none is smaller than a foot.
    """

    width: float
    sound: float
    flaws: tuple[GroundFlaw, ...]


def survey_ground(scene: Scene, rays: RayScene, half_width: float) -> SurveyedGround:
    """Look down on the corridor along a scene's trail, and feel what carries there.

    Args:
        scene: where.
        rays: of its mesh.
        half_width: of the corridor, m: half of a standing robot, without `WANDER`.
    """
    samples = trail_samples(scene, SPACING, behind=_BEHIND, most=_MOST)
    reach = half_width + WANDER
    sides = np.linspace(-reach, reach, 1 + 2 * round(reach / SPACING))
    xy = samples.points[:, None, :2] + sides[:, None] * samples.left[:, None]
    flat, above = xy.reshape(-1, 2), np.repeat(samples.above, len(sides))
    low = samples.points[:, 2:] - _DEEP
    seen = rays.height(flat, z_from=above).reshape(xy.shape[:2])
    seen = np.where(seen > low, seen, np.nan)
    felt = _felt(scene, flat, above).reshape(xy.shape[:2])
    felt = np.where(felt > low, felt, np.nan)
    # Under the lowest of what is seen there is but what catches what falls off a mesh.
    felt = np.where(felt < np.nanmin(seen, initial=np.inf) - TOLERANCE, np.nan, felt)
    lower = seen - felt > TOLERANCE
    flawed: dict[Flaw, Mask] = {
        "missing": np.isnan(seen) & np.isnan(felt),
        "untouched": ~np.isnan(seen) & (np.isnan(felt) | lower),
        "unseen": ~np.isnan(felt) & (np.isnan(seen) | (felt - seen > TOLERANCE)),
    }
    any_flaw = np.logical_or.reduce([flawed[kind] for kind in get_args(Flaw)])
    flaws = [
        flaw
        for kind, mask in flawed.items()
        for flaw in _stretches(kind, _foot_sized(mask), samples, xy, np.abs(seen - felt))
    ]
    return SurveyedGround(
        width=2 * reach,
        sound=float(1 - any_flaw.mean()),
        flaws=tuple(sorted(flaws, key=lambda flaw: (flaw.first, flaw.kind))),
    )


def _felt(scene: Scene, xy: Values, above: Values) -> Values:
    """Return the height at which physics stops what comes down at points, (N,) m, nan for nothing.

    Asked of MuJoCo's own geometry, boxes and height fields as a trial has them; of a mesh that
    collides by its own triangles, these are asked.
    """
    for solid in scene.solids:
        if isinstance(solid, Triangles):
            kinds = np.zeros(len(solid.faces), dtype=np.uint8)
            mesh = TriangleMesh(vertices=solid.vertices, faces=solid.faces, kinds=kinds)
            return RayScene(mesh).height(xy, z_from=above)
    spec = mujoco.MjSpec()
    add_geometry(spec, scene, friction=None)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    down, met = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
    depths = [
        mujoco.mj_ray(model, data, np.array([x, y, z]), down, None, 1, -1, met, None)
        for (x, y), z in zip(xy.tolist(), above.tolist(), strict=True)
    ]
    distance = np.array(depths)
    return np.where(distance >= 0, above - distance, np.nan)


def _foot_sized(mask: Mask) -> Mask:
    """Return the parts of a mask (S, L) that hold three by three samples: wider than a foot."""
    core = mask.copy()
    for axis in (0, 1):
        core = core & _shifted(core, 1, axis) & _shifted(core, -1, axis)
    for axis in (0, 1):
        core = core | _shifted(core, 1, axis) | _shifted(core, -1, axis)
    return core


def _shifted(mask: Mask, by: int, axis: int) -> Mask:
    moved = np.zeros_like(mask)
    to, source = (slice(1, None), slice(None, -1))[::by], (slice(None, -1), slice(1, None))[::by]
    if axis == 0:
        moved[to[0]] = mask[source[0]]
    else:
        moved[:, to[0]] = mask[:, source[0]]
    return moved


def _stretches(
    kind: Flaw, mask: Mask, samples: TrailSamples, xy: Values, off: Values
) -> Iterator[GroundFlaw]:
    """Yield the stretches of a mask (S, L) along the trail."""
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return
    along = samples.along
    breaks = np.flatnonzero(np.diff(along[rows]) > _APART) + 1
    for run in np.split(rows, breaks):
        part = np.zeros_like(mask)
        part[run] = mask[run]
        widest = int(part.sum(axis=1).max())
        x, y = xy[part].mean(axis=0).tolist()
        differences = off[part]
        differences = differences[np.isfinite(differences)]
        yield GroundFlaw(
            kind=kind,
            first=float(along[run[0]]),
            last=float(along[run[-1]]),
            width=widest * SPACING,
            area=float(part.sum()) * SPACING**2,
            off=float(differences.max()) if differences.size else None,
            across=widest == mask.shape[1],
            place=(x, y, float(samples.points[run, 2].mean())),
        )
