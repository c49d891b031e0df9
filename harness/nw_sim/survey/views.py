"""What the splat and the mesh show a robot's camera along a course, and what is wrong with it.

How far a splat lies off the mesh is told with the direction in which it does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_scenes.finding import SceneFinding, Severity
from nw_scenes.rays import RayScene
from nw_scenes.robots import RobotSpec
from nw_scenes.scene import Nearness, Scene
from nw_sim.survey.course import CAMERA, CourseSamples, Stance, camera_poses, course_samples
from nw_splat.camera import Camera
from nw_splat.render import CpuRenderer
from nw_splat.store import open_store

Values = NDArray[np.float64]

SPACING = 0.25
"""Between views along the course, m."""
MOST_VIEWS = 240
"""Views of one scene; on a longer course they are farther apart."""
NEAR = 3.0
"""Depth up to which splat and mesh are compared, m."""

_BEYOND = 1.0  # m behind what is near where Gaussians are left out: a far backdrop covers nothing
_SIZE = (96, 54)  # pixels
_ENOUGH = 250  # pixels that a view is judged by
_SOLID = 0.5  # coverage from which a pixel of the splat has a depth
# What belongs to the course: so far to each side of the course, and below and above it, m. Beside
# it Gaussians may be coarse, and the ground of a gap may be anything.
_BESIDE = 0.5
_BELOW = 0.1
_ABOVE = 0.6
# What stands on the way or was dug into it reaches deeper, m.
_DEPTH = 0.6
Mask = NDArray[np.bool_]

_ENOUGH_OF_DIRECTION = 300  # pixels that a direction is judged by
_ALIKE = 0.9  # cosine of the angle up to which a surface faces along an axis
_GRAZED = 0.1  # cosine below which a surface is seen too flatly to be judged
_OTHER = 0.6  # m; what is farther off is something else
_HEIGHTS_FIRST = 0.05  # m; beyond it other edges are in view, and tell nothing of the sides
_AGREED = 0.05  # m, within which half of what moved as one lies

# Measured on the built-in places: what is near is covered to 0.98 in the worst view; a splat that
# lies where it should seems up to 0.04 m off; half of a course is within 0.012 m of its splat, and
# 95 % within 0.103 m. One that is moved by 0.2 m seems 0.12 m off, or more.

LEAST_COVERED = 0.9
"""Share of what is near that the splat should cover."""
TOO_LITTLE = 0.75
"""Share below which images show something else than the scene."""
MOST_SHIFT = 0.1
"""How far a splat may lie from the mesh, m."""
MOST_MEDIAN = 0.1
"""How far half of the course may be from its splat, m."""
MOST_P95 = 0.125
"""How far 95 % of the course should be from its splat at most, m."""
FAR_P95 = 0.25
"""From where on that is an error, m."""
FARTHEST = 1.5
"""How far the robot's camera should be from the nearest capture camera, m."""
WIDEST = 1.0
"""Angle between the two optical axes, rad, as above."""


def survey_views(scene: Scene, rays: RayScene, robot: RobotSpec, stance: Stance) -> SurveyedViews:
    """Look along a scene's course with a robot's camera, as it stands there.

    Args:
        scene: with a splat.
        rays: of its mesh.
        robot: whose camera.
        stance: of that robot.

    Raises:
        SceneError: the splat cannot be read.
    """
    samples = course_samples(scene, SPACING, most=MOST_VIEWS)
    renderer = CpuRenderer(open_store(scene.splat_store()), projection="ray")
    looker = _Looker(scene, rays, robot, renderer, samples)
    poses = camera_poses(samples, rays, stance)
    views, residuals = zip(*map(looker.look, samples.along.tolist(), poses), strict=True)
    return SurveyedViews(views=views, disagreement=disagreement(Residuals.joined(residuals)))


@dataclass(frozen=True, kw_only=True)
class SurveyedViews:
    """All views along a course, at least one.

    Attributes:
        views: in the order of the course.
        disagreement: of splat and mesh, over all of them.
    """

    views: tuple[SurveyedView, ...]
    disagreement: Disagreement


@dataclass(frozen=True, kw_only=True)
class SurveyedView:
    """What the robot's camera sees at one point of the course.

    Attributes:
        along: m from the start.
        position: of the camera, world, m.
        alpha: share of the image that the splat covers, as `gate.validity` has it.
        covered: share of what the mesh shows within `NEAR` that the splat covers; None where the
            mesh shows next to nothing so near.
        median, p95: how far the splat is off the mesh's surface on the course ahead, m; None where
            next to nothing of the course is in view.
        nearest: how far the nearest capture camera is; None if unknown.
    """

    along: float
    position: tuple[float, float, float]
    alpha: float
    covered: float | None
    median: float | None
    p95: float | None
    nearest: Nearness | None


class _Looker:
    """Renders and casts the same pixels."""

    def __init__(
        self,
        scene: Scene,
        rays: RayScene,
        robot: RobotSpec,
        renderer: CpuRenderer,
        samples: CourseSamples,
    ) -> None:
        width, height = _SIZE
        lens = robot.cameras[CAMERA].lens(width, height)
        self._camera = Camera.of(lens, np.eye(4))
        columns = np.arange(width, dtype=np.float64) + 0.5
        rows = np.arange(height, dtype=np.float64) + 0.5
        slopes = lens.grid(columns, rows)
        toward = np.concatenate([slopes, np.ones((height, width, 1))], axis=-1).reshape(-1, 3)
        self._directions = toward / np.linalg.norm(toward, axis=1, keepdims=True)
        self._rays, self._renderer, self._captures = rays, renderer, scene.captures
        self._T_splat_world = same_bits.inverse(scene.T_world_splat)
        corners = rays.mesh.triangles
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = normals / np.maximum(lengths, 1e-30)
        self._trail = samples.points

    def look(self, along: float, T_world_camera: Values) -> tuple[SurveyedView, Residuals]:
        # The splat's scale stays in the matrix, so that depths are in metres.
        camera = replace(self._camera, T_world_camera=self._T_splat_world @ T_world_camera)
        alpha = float(self._renderer.render(camera).alpha.mean())
        # Where pixels meet Gaussians, as depth cameras see it: in front of where grazed ground is
        # seen lie the centres of wide ones.
        depth, close = self._renderer.surface(replace(camera, far=NEAR + _BEYOND))
        cover = close.ravel().astype(np.float64)
        directions = self._directions @ T_world_camera[:3, :3].T
        eye = T_world_camera[:3, 3]
        distance, face = self._rays.cast(np.broadcast_to(eye, directions.shape), directions)
        ahead = self._directions[:, 2]
        near = np.flatnonzero(distance * ahead < NEAR)
        points = eye + directions[near] * distance[near, None]
        over = self._over_trail(points)
        normals = self._normals[face[near]]
        facing = (normals * directions[near]).sum(axis=1)
        normals, facing = normals * -np.sign(facing)[:, None], np.abs(facing)
        # Along the normal: what a pixel is off along its ray grows without end on grazed ground.
        beyond = depth.ravel()[near] / ahead[near] - distance[near]
        solid = cover[near] > _SOLID
        residuals = Residuals(
            off=(-beyond * facing)[solid],
            normals=normals[solid],
            facing=facing[solid],
            course=(over > -_BELOW)[solid],
            built=(over > -_DEPTH)[solid],
        )
        there = np.abs(residuals.off[residuals.course])
        x, y, z = eye.tolist()
        view = SurveyedView(
            along=along,
            position=(x, y, z),
            alpha=alpha,
            covered=float(cover[near].mean()) if near.size >= _ENOUGH else None,
            median=float(np.median(there)) if there.size >= _ENOUGH else None,
            p95=float(np.quantile(there, 0.95)) if there.size >= _ENOUGH else None,
            nearest=None if self._captures is None else self._captures.nearest(T_world_camera),
        )
        return view, residuals

    def _over_trail(self, points: Values) -> Values:
        """Return how high points (N, 3) of the way are over the course, (N,) m; -inf beside it."""
        x, y = (points[:, [axis]] - self._trail[:, axis] for axis in (0, 1))
        squares = x * x + y * y
        over = points[:, 2] - self._trail[squares.argmin(axis=1), 2]
        return np.where((squares.min(axis=1) < _BESIDE**2) & (over < _ABOVE), over, -np.inf)


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
        elif min(int(side.sum()) for side in sides) < _ENOUGH_OF_DIRECTION:
            sides = [side if _agree(off[side]) else side & built for side in sides]
        errors = [
            (sign, off[side])
            for sign, side in zip((1.0, -1.0), sides, strict=True)
            if side.sum() >= _ENOUGH_OF_DIRECTION
        ]
        if not errors:
            continue
        if len(errors) == 1 or upright:
            sign, alone = max(errors, key=lambda each: len(each[1]))
            middle, width = _most(alone)
            moved = sign * middle
            as_one &= width < _AGREED
        else:
            moved = sum(sign * float(np.median(side)) for sign, side in errors) / 2
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Residuals:
    """Pixels in which both splat and mesh show something.

    Attributes:
        off: (N,) m from the mesh to the splat along the surface's normal; positive = towards the
            camera.
        normals: (N, 3) of the mesh there, world, towards the camera.
        facing: (N,) cosine of the angle between normal and ray.
        course: (N,) whether the point is on the course: near the course, and neither high nor deep.
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


def _axes(normals: Values, weights: Values) -> Values:
    """Return the two level directions along which upright surfaces mostly face, and up; (3, 3)."""
    upright = np.abs(normals[:, 2]) < 0.4
    # Walls at right angles to each other have one angle when it is taken four times.
    fourfold = (normals[upright, 0] + 1j * normals[upright, 1]) ** 4 * weights[upright]
    turn = float(np.angle(fourfold.sum())) / 4
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _agree(values: Values) -> bool:
    return len(values) >= _ENOUGH_OF_DIRECTION and _most(values)[1] < _AGREED


def _most(values: Values) -> tuple[float, float]:
    """Return the middle and the width of the shortest interval that holds half of the values.

    What an edge hides or uncovers spoils a median, but does not gather anywhere.
    """
    ordered = np.sort(values)
    half = len(ordered) // 2
    widths = ordered[half:] - ordered[: len(ordered) - half]
    first = int(np.argmin(widths))
    return float(ordered[first] + ordered[first + half]) / 2, float(widths[first])


def view_findings(seen: SurveyedViews) -> list[SceneFinding]:
    """Return what is wrong with the splat as it is seen from a course."""
    return [*_coverage(seen.views), *_depth(seen), *_captures(seen.views)]


def _coverage(views: tuple[SurveyedView, ...]) -> list[SceneFinding]:
    findings: list[SceneFinding] = []
    near = [(view.covered, view) for view in views if view.covered is not None]
    if near:
        share, view = min(near, key=lambda each: each[0])
        below = sum(covered < LEAST_COVERED for covered, _ in near)
        if below:
            severity: Severity = "error" if share < TOO_LITTLE else "warning"
            findings.append(
                SceneFinding(
                    code="splat_thin",
                    severity=severity,
                    message=f"the splat covers {100 * share:.0f} % of what the mesh shows within "
                    f"{NEAR:g} m at {_where(view)}; "
                    f"{100 * LEAST_COVERED:.0f} % is wanted, and {below} of {len(near)} views "
                    "have less",
                    fix="train it on photographs of that stretch, or move the course elsewhere",
                    value=share,
                    place=view.position,
                )
            )
    emptiest = min(views, key=lambda view: view.alpha)
    if emptiest.alpha < LEAST_COVERED and not findings:
        findings.append(
            SceneFinding(
                code="open_view",
                severity="note",
                message=f"the splat covers {100 * emptiest.alpha:.0f} % of the complete image at "
                f"{_where(emptiest)}; the other pixels are white, and far away or empty in the "
                "mesh, too",
                fix="`alpha` of a suite's gate.validity must be below that",
                value=emptiest.alpha,
                place=emptiest.position,
            )
        )
    return findings


def _depth(seen: SurveyedViews) -> list[SceneFinding]:
    disagreement = seen.disagreement
    x, y, z = disagreement.shift
    moved = (x * x + y * y + z * z) ** 0.5
    if moved > MOST_SHIFT:
        return [_shifted(disagreement, moved)]
    median, p95 = disagreement.median, disagreement.p95
    if median is None or p95 is None or (median <= MOST_MEDIAN and p95 <= MOST_P95):
        return []
    view = max(seen.views, key=lambda view: view.p95 or 0.0)
    return [
        SceneFinding(
            code="splat_off_mesh",
            severity="error" if median > MOST_MEDIAN or p95 > FAR_P95 else "warning",
            message=f"on the course within {NEAR:g} m splat and mesh are {median:.3f} m apart in "
            f"the median and {p95:.3f} m in the 95th percentile ({MOST_MEDIAN:g} and "
            f"{MOST_P95:g} m are allowed); it is worst at {_where(view)}, there "
            f"{view.p95 or 0.0:.2f} m",
            fix="check `nw-eval scenes render`: Gaussians float there, or the mesh is coarse",
            value=p95,
            place=view.position,
        )
    ]


def _shifted(disagreement: Disagreement, moved: float) -> SceneFinding:
    x, y, z = disagreement.shift
    fix = f"check T_world_splat; adding ({-x:.2f}, {-y:.2f}, {-z:.2f}) to its translation fits"
    if not disagreement.shifts_as_one:
        fix = "check T_world_splat: scale, rotation and translation"
    return SceneFinding(
        code="splat_shifted",
        severity="error",
        message=f"the splat lies ({x:.2f}, {y:.2f}, {z:.2f}) m from the mesh, {moved:.2f} m in "
        f"all; {MOST_SHIFT:g} m is allowed",
        fix=fix,
        value=moved,
    )


def _captures(views: tuple[SurveyedView, ...]) -> list[SceneFinding]:
    known = [(view.nearest, view) for view in views if view.nearest is not None]
    beyond = [
        (nearest, view)
        for nearest, view in known
        if nearest.distance > FARTHEST or nearest.angle > WIDEST
    ]
    if not beyond:
        return []
    nearest, view = max(
        beyond, key=lambda each: max(each[0].distance / FARTHEST, each[0].angle / WIDEST)
    )
    return [
        SceneFinding(
            code="far_from_captures",
            severity="warning",
            message=f"nothing was photographed like the robot's view at {_where(view)}: the "
            f"nearest camera is {nearest.distance:.2f} m away and turned by "
            f"{nearest.angle:.2f} rad ({FARTHEST:g} m and {WIDEST:g} rad are allowed); "
            f"the same holds for {len(beyond)} of {len(known)} views",
            fix="photograph that stretch again, from low down, along the course",
            value=nearest.distance,
            place=view.position,
        )
    ]


def _where(view: SurveyedView) -> str:
    x, y, _ = view.position
    return f"{view.along:.2f} m along the course, ({x:.2f}, {y:.2f})"
