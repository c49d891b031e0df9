"""State of a labelling: a scene's placement, its crop, and the robot's course.

A placement is a similarity, with the moves that change it. A crop is a box of the world; triangles
of a mesh are cut at its sides. A state is one value that is never changed, only followed by
another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import UsageError
from nw_base.words import Task
from nw_scenes.limits import REACH, WAYPOINTS, check_similarity
from nw_scenes.mesh import TriangleMesh, rotation_matrix
from nw_splat.gaussians import quaternions

Point = tuple[float, float, float]
"""x, y, z in the world, m."""

Axis = Literal["x", "y", "z"]

Unit = Literal["m", "cm", "mm", "inch", "feet"]
METRES: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "feet": 0.3048}
"""In one of each unit that scans come in."""

_LEAST_WIDTH = 0.05
"""Of a triangle of points on a floor, of its longest side."""


@dataclass(frozen=True, kw_only=True)
class Placement:
    """From the frame of the opened files to the world: scale, then rotation, then translation.

    Attributes:
        scale: metres in one unit of the files.
        quat: w x y z, of unit length.
        translation: m.
    """

    scale: float = 1.0
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    translation: Point = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, T: NDArray[np.float64]) -> Placement:
        """Return the placement of a (4, 4) similarity.

        Raises:
            SceneError: it stretches, mirrors or flattens, or its scale is out of bounds.
        """
        scale = check_similarity(T, "the scene")
        w, x, y, z = quaternions(T[:3, :3] / scale).tolist()
        return cls(scale=scale, quat=(w, x, y, z), translation=as_point(T[:3, 3]))

    @property
    def matrix(self) -> NDArray[np.float64]:
        """T_world_file, (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = self.scale * rotation_matrix(self.quat)
        T[:3, 3] = self.translation
        return T


def turn(axis: Axis, angle: float, about: Point) -> NDArray[np.float64]:
    """Return the (4, 4) turn by an angle (rad, right-handed) about an axis through a point."""
    i = "xyz".index(axis)
    quat = [math.cos(angle / 2), 0.0, 0.0, 0.0]
    quat[1 + i] = math.sin(angle / 2)
    T = np.eye(4)
    T[:3, :3] = rotation_matrix(quat)
    T[:3, 3] = np.array(about) - T[:3, :3] @ np.array(about)
    return T


def shift(offset: Point) -> NDArray[np.float64]:
    """Return the (4, 4) shift by an offset, m."""
    T = np.eye(4)
    T[:3, 3] = offset
    return T


def stretch(factor: float) -> NDArray[np.float64]:
    """Return the (4, 4) scaling about the origin, which leaves a floor at z = 0 where it is."""
    return np.diag([factor, factor, factor, 1.0])


def level_on(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (4, 4) motion that lays three points (3, 3) on z = 0, and turns nothing else.

    What looks most upwards of their plane looks up afterwards.

    Raises:
        UsageError: they lie too much along a line.
    """
    ways = points[1:] - points[0]
    normal = np.cross(ways[0], ways[1])
    longest = max(float(np.linalg.norm(a - b)) for a in points for b in points)
    if np.linalg.norm(normal) < _LEAST_WIDTH * longest * longest:
        raise UsageError(
            "the three points on the floor lie along a line",
            fix="click the third one well to the side of the other two",
        )
    normal = normal / np.linalg.norm(normal) * (1.0 if normal[2] >= 0 else -1.0)
    axis = np.cross(normal, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(normal[2])
    quat = [1.0, 0.0, 0.0, 0.0]
    if sine > 0:
        half = math.atan2(sine, cosine) / 2
        quat = [math.cos(half), *(math.sin(half) / sine * axis).tolist()]
    T = np.eye(4)
    T[:3, :3] = rotation_matrix(quat)
    middle = points.mean(axis=0)
    T[:3, 3] = middle - T[:3, :3] @ middle - np.array([0.0, 0.0, middle[2]])
    return T


def mapped(points: NDArray[np.float64], T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (N, 3) under a (4, 4) transform."""
    return points @ T[:3, :3].T + T[:3, 3]


def as_point(values: NDArray[np.float64]) -> Point:
    """Return an array (3,) as a point of plain floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


@dataclass(frozen=True, kw_only=True)
class CropBox:
    """Crop of a scene: a box with its sides along the world's axes.

    Attributes:
        low: smallest x, y, z; world, m.
        high: largest x, y, z.

    Raises:
        UsageError: nothing lies between `low` and `high`.
    """

    low: Point
    high: Point

    def __post_init__(self) -> None:
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise UsageError(
                f"a crop from {list(self.low)} to {list(self.high)} holds nothing",
                fix="give a low corner that is below the high one along x, y and z",
            )


def cropped(mesh: TriangleMesh, box: CropBox) -> TriangleMesh:
    """Return the part of a mesh in a box, without lids where it is cut; kinds stay.

    Vertices that no face needs any more are left out. Nothing may be left: no faces then.
    """
    for axis in range(3):
        mesh = _cut(mesh, mesh.vertices[:, axis] - box.low[axis])
        mesh = _cut(mesh, box.high[axis] - mesh.vertices[:, axis])
    needed, faces = np.unique(mesh.faces, return_inverse=True)
    return TriangleMesh(
        vertices=mesh.vertices[needed],
        faces=faces.reshape(-1, 3).astype(np.int32),
        kinds=mesh.kinds,
    )


def _cut(mesh: TriangleMesh, depth: NDArray[np.float64]) -> TriangleMesh:
    """Return the part of a mesh where `depth` (V,), which is linear in space, is not negative."""
    count = (depth[mesh.faces] >= 0).sum(axis=1)
    one, two = (_turned(mesh, depth, np.flatnonzero(count == n)) for n in (1, 2))
    first = len(mesh.vertices)
    # Of a corner inside, the two edges that leave it; of two, the edges that leave the pair.
    tips = (
        _crossings(mesh, depth, one[:, 0], one[:, 1]),
        _crossings(mesh, depth, one[:, 0], one[:, 2]),
    )
    ends = (
        _crossings(mesh, depth, two[:, 1], two[:, 2]),
        _crossings(mesh, depth, two[:, 0], two[:, 2]),
    )
    a, b = first + np.arange(len(one)), first + len(one) + np.arange(len(one))
    start = first + 2 * len(one)
    c, d = start + np.arange(len(two)), start + len(two) + np.arange(len(two))
    faces = [
        mesh.faces[count == 3],
        np.column_stack([one[:, 0], a, b]),
        np.column_stack([two[:, 0], two[:, 1], c]),
        np.column_stack([two[:, 0], c, d]),
    ]
    kinds = [mesh.kinds[count == n] for n in (3, 1, 2, 2)]
    return TriangleMesh(
        vertices=np.concatenate([mesh.vertices, *tips, *ends]),
        faces=np.concatenate(faces).astype(np.int32),
        kinds=np.concatenate(kinds),
    )


def _turned(
    mesh: TriangleMesh, depth: NDArray[np.float64], rows: NDArray[np.intp]
) -> NDArray[np.int64]:
    """Return faces with their odd corner first (one inside), or last (two inside), same winding."""
    faces = mesh.faces[rows].astype(np.int64)
    inside = depth[faces] >= 0
    alone = inside.sum(axis=1) == 1
    odd = np.where(alone, inside.argmax(axis=1), (~inside).argmax(axis=1))
    begin = np.where(alone, odd, odd + 1)
    return np.take_along_axis(faces, (begin[:, None] + np.arange(3)) % 3, axis=1)


def _crossings(
    mesh: TriangleMesh,
    depth: NDArray[np.float64],
    kept: NDArray[np.int64],
    lost: NDArray[np.int64],
) -> NDArray[np.float64]:
    share = depth[kept] / (depth[kept] - depth[lost])
    return mesh.vertices[kept] + share[:, None] * (mesh.vertices[lost] - mesh.vertices[kept])


@dataclass(frozen=True, kw_only=True)
class StartPose:
    """Where the robot starts.

    Attributes:
        position: on the ground; world, m.
        yaw: where it looks, rad; 0 = along x.
    """

    position: Point
    yaw: float


@dataclass(frozen=True, kw_only=True)
class LabelState:
    """One state of a labelling.

    Attributes:
        task: what the course asks of the robot.
        waypoints: in order, on top of what the robot steps on; world, m.
        start: None = 1 m before the first waypoint, looking at it.
        placement: of the files that were opened.
        crop: box in the world that the placed scene is cut to; None = no crop.
        markers: two at most, for measuring; world, m.
        floor: two at most of the three points that lay the floor; world, m.
        to_scale: whether lengths are metres; else in an unknown unit.

    Raises:
        UsageError: a point is no place for a waypoint, or there are too many.
    """

    task: Task
    waypoints: tuple[Point, ...] = ()
    start: StartPose | None = None
    placement: Placement = field(default_factory=Placement)
    crop: CropBox | None = None
    markers: tuple[Point, ...] = ()
    floor: tuple[Point, ...] = ()
    to_scale: bool = True

    def __post_init__(self) -> None:
        if len(self.waypoints) > WAYPOINTS:
            raise UsageError(
                f"there are {len(self.waypoints)} waypoints", fix=f"give {WAYPOINTS} at most"
            )
        points = [*self.waypoints, *self.markers, *self.floor]
        if self.start is not None:
            points.append(self.start.position)
        for point in points:
            if not all(abs(part) <= REACH for part in point):
                raise UsageError(
                    f"a point at {list(point)}",
                    fix=f"points lie within {REACH:g} m of the origin: shift or scale the scene",
                )

    def moved(self, delta: NDArray[np.float64]) -> LabelState:
        """Return the state after the scene was moved by a (4, 4) similarity.

        Waypoints, start and markers move along. The crop's middle does too, and its size scales,
        but its sides stay along the axes.

        Raises:
            SceneError: the scene's scale would be out of bounds.
            UsageError: a point would be too far away.
        """
        scale = float(np.linalg.det(delta[:3, :3])) ** (1 / 3)
        start, crop = self.start, self.crop
        if start is not None:
            x, y, _ = delta[:3, :3] @ [math.cos(start.yaw), math.sin(start.yaw), 0.0]
            (position,) = _moved((start.position,), delta)
            start = StartPose(position=position, yaw=math.atan2(y, x))
        if crop is not None:
            low, high = np.array(crop.low), np.array(crop.high)
            middle = mapped((low + high)[None] / 2, delta)[0]
            half = (high - low) / 2 * scale
            crop = CropBox(low=as_point(middle - half), high=as_point(middle + half))
        return replace(
            self,
            placement=Placement.of(delta @ self.placement.matrix),
            waypoints=_moved(self.waypoints, delta),
            start=start,
            crop=crop,
            markers=_moved(self.markers, delta),
            floor=_moved(self.floor, delta),
        )


def _moved(points: tuple[Point, ...], delta: NDArray[np.float64]) -> tuple[Point, ...]:
    if not points:
        return ()
    return tuple(as_point(row) for row in mapped(np.array(points), delta))
