"""What the splat and the mesh show a robot's camera along a trail."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nw_eval.robots import RobotSpec
from nw_eval.scenes.rays import RayScene
from nw_eval.scenes.scene import Nearness, Scene
from nw_eval.splat.camera import Camera
from nw_eval.splat.render import Renderer, open_renderer
from nw_eval.splat.store import open_store
from nw_eval.survey.disagreement import Disagreement, Residuals, disagreement
from nw_eval.survey.samples import TrailSamples, trail_samples
from nw_eval.survey.stance import CAMERA, Stance, camera_poses

Values = NDArray[np.float64]

SPACING = 0.25
"""Between views along the trail, m."""
MOST_VIEWS = 240
"""Views of one scene; on a longer trail they are farther apart."""
NEAR = 3.0
"""Depth up to which splat and mesh are compared, m."""

_BEYOND = 1.0  # m behind what is near where Gaussians are left out: a far backdrop covers nothing
_SIZE = (96, 54)  # pixels
_ENOUGH = 250  # pixels that a view is judged by
_SOLID = 0.5  # coverage from which a pixel of the splat has a depth
# What belongs to the course: so far to each side of the trail, and below and above it, m. Beside it
# Gaussians may be coarse, and the ground of a gap may be anything.
_BESIDE = 0.5
_BELOW = 0.1
_ABOVE = 0.6
# What stands on the way or was dug into it reaches deeper, m.
_DEPTH = 0.6


@dataclass(frozen=True, kw_only=True)
class SurveyedView:
    """What the robot's camera sees at one place of the trail.

    Attributes:
        along: m from the start.
        position: of the camera, world, m.
        alpha: share of the image that the splat covers, as `gate.validity` has it.
        covered: share of what the mesh shows within `NEAR` that the splat covers; None where the
            mesh shows next to nothing so near.
        median, p95: how far the splat is off the mesh's surface on the course ahead, m; None where
            next to nothing of the course is in view.
        nearest: how far the nearest capture camera is; None where nobody says.
    """

    along: float
    position: tuple[float, float, float]
    alpha: float
    covered: float | None
    median: float | None
    p95: float | None
    nearest: Nearness | None


@dataclass(frozen=True, kw_only=True)
class SurveyedViews:
    """All views along a trail, at least one.

    Attributes:
        views: in the order of the trail.
        disagreement: of splat and mesh, over all of them.
    """

    views: tuple[SurveyedView, ...]
    disagreement: Disagreement


def survey_views(scene: Scene, rays: RayScene, robot: RobotSpec, stance: Stance) -> SurveyedViews:
    """Look along a scene's trail with a robot's camera, as it stands there.

    Args:
        scene: with a splat.
        rays: of its mesh.
        robot: whose camera.
        stance: of that robot.

    Raises:
        SceneError: the splat cannot be read.
    """
    samples = trail_samples(scene, SPACING, most=MOST_VIEWS)
    renderer = open_renderer(open_store(scene.splat_store()), "cpu")
    looker = _Looker(scene, rays, robot, renderer, samples)
    poses = camera_poses(samples, rays, stance)
    views, residuals = zip(*map(looker.look, samples.along.tolist(), poses), strict=True)
    return SurveyedViews(views=views, disagreement=disagreement(Residuals.joined(residuals)))


class _Looker:
    """Renders and casts the same pixels."""

    def __init__(
        self,
        scene: Scene,
        rays: RayScene,
        robot: RobotSpec,
        renderer: Renderer,
        samples: TrailSamples,
    ) -> None:
        width, height = _SIZE
        fovy = robot.cameras[CAMERA].fovy
        self._camera = Camera.from_fovy(
            width=width, height=height, fovy=fovy, T_world_camera=np.eye(4)
        )
        columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        camera = self._camera
        toward = np.stack(
            [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, columns * 0 + 1.0],
            axis=-1,
        ).reshape(-1, 3)
        self._directions = toward / np.linalg.norm(toward, axis=1, keepdims=True)
        self._rays, self._renderer, self._captures = rays, renderer, scene.captures
        self._T_splat_world = np.linalg.inv(scene.T_world_splat)
        corners = rays.mesh.triangles
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = normals / np.maximum(lengths, 1e-30)
        self._trail = samples.points

    def look(self, along: float, T_world_camera: Values) -> tuple[SurveyedView, Residuals]:
        # The splat's scale stays in the matrix, so that depths are in metres.
        camera = replace(self._camera, T_world_camera=self._T_splat_world @ T_world_camera)
        alpha = float(self._renderer.render(camera).alpha.mean())
        close = self._renderer.render(replace(camera, far=NEAR + _BEYOND))
        cover = close.alpha.ravel().astype(np.float64)
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
        beyond = close.depth.ravel()[near] / ahead[near] - distance[near]
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
        """Return how high points (N, 3) of the way are over the trail, (N,) m; -inf beside it."""
        x, y = (points[:, [axis]] - self._trail[:, axis] for axis in (0, 1))
        squares = x * x + y * y
        over = points[:, 2] - self._trail[squares.argmin(axis=1), 2]
        return np.where((squares.min(axis=1) < _BESIDE**2) & (over < _ABOVE), over, -np.inf)
