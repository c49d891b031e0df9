"""Scans that others made, to scenes: meshes, point clouds and elevation maps.

What comes in is in the axes and the unit of its file. What comes out is a scene folder in metres
with z up, its ground at z = 0 where the robot starts.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import SceneError, UsageError
from nw_base.files.cache import check_new, new_folder
from nw_base.words import Task
from nw_eval.api import check_scenes
from nw_eval.suite.load import check_has_policy, robot_from, write_ready_suite
from nw_scenes import limits
from nw_scenes.check import room_of
from nw_scenes.elevation_file import ELEVATION_SUFFIXES, elevation_mesh, read_elevation
from nw_scenes.folder import SCENE_FILE, load_folder
from nw_scenes.limits import name_of
from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.mesh_file import MESH_SUFFIXES, PaintedMesh, read_painted, unread
from nw_scenes.mesh_parts import Material
from nw_scenes.rays import RayScene
from nw_scenes.saving import COLLISION, rounded, write_collision, write_yaml
from nw_scenes.scene import Spawn
from nw_scenes.surface import Surface
from nw_sim.survey import footing_lines, survey_lines
from nw_sim.survey.ground import holes_along
from nw_twin.align.upright import AXES, up_of_mesh
from nw_twin.course import HALF_WIDTH
from nw_twin.place import SUITE, Route, check_scene_name, moved_points
from nw_twin.scans.converted import USD_SUFFIXES, read_stage
from nw_twin.scans.looks import write_looks
from nw_twin.scans.points import CLOUD_SUFFIXES, is_cloud, is_splat, surfaced
from nw_twin.walkable import Walkable, walkable

Values = NDArray[np.float64]
Unit = Literal["m", "cm", "mm", "ft", "in"]
UnitOrAuto = Literal["auto", "m", "cm", "mm", "ft", "in"]
Axis = Literal["auto", "+x", "-x", "+y", "-y", "+z", "-z"]

UNITS: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}
"""Metres in each."""

_FAR = 100.0
"""A scan whose middle is farther from its origin, metres, is moved there: single precision."""
_ODDLY_WIDE = 200.0
"""Metres, from which on the unit is asked about."""
_LEVEL = math.cos(math.radians(20.0))
_SURE = 5.0
"""Degrees: up that is known worse is asked for."""
_STEP, _STRIDE, _ROOM = 0.25, 0.1, 0.2
"""Of a proposed trail: highest step, distance of samples along it, and room to each side."""
_ROOMS = (1.8, 6.0)
"""Heights of rooms, m; beyond, the unit is asked about."""
_FOOT, _HEADROOM = 0.02, 0.6
"""Above the ground of a proposed course, m."""
_ON_FLOOR = 0.15
"""From the height of the floor that a course begins at, m; beyond, another is preferred."""
_EVEN = 0.05
"""By which the ground of a course rises and falls that is called even, m."""
_INCLINED = math.radians(8.0)
"""Of the ground at the start, from which on it is said; beyond 20 degrees no robot starts there."""
_LONGEST, _BEHIND = 4.0, 0.7
"""Of a proposed course, and of the ground behind its end and before its start; metres."""
_TRIED, _HOLED, _BUMPY = 8, 20.0, 5.0
"""Ways of one heading that are looked at for holes, and what a hole costs and a metre by which the
ground rises and falls, in half metres of course."""
_AS_SEEN = 0.05
"""Difference between the ground that is seen and that which physics has, m."""


@dataclass(frozen=True, kw_only=True)
class ScanOptions:
    """How a scan is to be understood.

    Attributes:
        unit: of the file's numbers; `auto` is what a comment of the file names, or else the metre.
        up: which axis of the file is up; `auto` is by all cues together: what the format says, the
            mesh's planes, and how it lies.
        splat: Gaussians of the same scene, such as the same app exports; None = they are made of
            the mesh's colours, if it has some. A splat that is imported alone shows itself.
        splat_transform: a text file of 16 numbers, the 4 x 4 matrix from the splat's numbers to
            the mesh's; None = it is found among the turns by right angles.
        gaussians: most that are made of a mesh's colours.
        cell, white, black, no_data: of an elevation map, as `read_elevation` takes them.
        trail: start, and waypoints x, y or x, y, z, metres in the scene; None = it is proposed.
        name: of the scene; None = that of its folder.
        licence: of the scan.
        task: what the course asks of the robot; None = `open`.
        robot: of the scene's suite.
    """

    unit: UnitOrAuto = "auto"
    up: Axis = "auto"
    splat: Path | None = None
    splat_transform: Path | None = None
    gaussians: int = 200_000
    cell: float | None = None
    white: float | None = None
    black: float = 0.0
    no_data: float | None = None
    trail: tuple[tuple[float, ...], ...] | None = None
    name: str | None = None
    licence: str = "not stated"
    task: Task | None = None
    robot: str = "go1"


@dataclass(frozen=True, kw_only=True)
class WrittenScan:
    """A scene that a scan became.

    Attributes:
        folder: where it lies.
        digest: of the scene.
        before: the digest that it had; None of a new one, or one that could not be loaded.
        lines: one line for each step that was done.
        fault: why it is not ready: no robot can start there yet, or `scenes check` finds an error;
            with what to do. None = it is.
    """

    folder: Path
    digest: str
    before: str | None
    lines: tuple[str, ...]
    fault: str | None = None


def import_scan(source: Path, out: Path, options: ScanOptions | None = None) -> WrittenScan:
    """Write the scene folder of a scan, and a suite beside it; whole or not at all.

    Args:
        source: a mesh (GLB, USDZ, OBJ, PLY, STL), a point cloud (PLY, LAS, LAZ, E57), a splat
            (PLY, SPZ, SOG), or an elevation map (PNG, GeoTIFF).
        out: the folder, which must not be there.
        options: how it is to be understood.

    Raises:
        UsageError: an option makes no sense of this file, or `out` is in use.
        SceneError: a file cannot be read, or the scene cannot be loaded.
        StoreError: it cannot be written.
        PrerequisiteError: a package that point clouds or USD need is not installed.
    """
    options = ScanOptions() if options is None else options
    check_new(out)
    check_has_policy(options.robot)
    name = name_of(out.name) if options.name is None else options.name
    check_scene_name(name)
    _check_used(source, options)
    scan, lines = _read_scan(source, options)
    mesh = _mesh_of(scan, scan.T_world_file)
    course, words, fault = lay_course(mesh, options.trail, options.task)
    lines += words
    fault = scan.fault or fault
    lift = np.eye(4)
    lift[2, 3] = -course.spawn[2]
    course = replace(
        course,
        trail=course.trail + lift[:3, 3],
        spawn=(course.spawn[0], course.spawn[1], 0.0),
    )
    T = lift @ scan.T_world_file
    text: dict[str, Any] = {
        "nw-scene": 1,
        "name": name,
        "title": f"From {clean(source.name, at_most=80)}",
        "task": course.task,
        "licence": options.licence,
        "collision": COLLISION,
        "trail": [rounded(point) for point in course.trail],
        "spawn": {"position": rounded(course.spawn), "yaw": round(course.yaw, 4)},
    }
    with new_folder(out) as staged:
        write_collision(
            staged / COLLISION, moved_points(T, scan.painted.vertices), scan.painted.faces
        )
        lines += write_looks(
            staged,
            text,
            scan.painted,
            T,
            splat=source if scan.is_splat else options.splat,
            splat_transform=options.splat_transform,
            is_own=scan.is_splat,
            most=options.gaussians,
            way=np.vstack([course.spawn, course.trail]),
        )
        write_yaml(staged / SCENE_FILE, text)
        digest = load_folder(staged).digest
        write_ready_suite(staged / SUITE, name, ["."], robot=robot_from(out, options.robot))
    written = WrittenScan(folder=out, digest=digest, before=None, lines=tuple(lines), fault=fault)
    return checked_scan(written, options.robot)


def checked_scan(written: WrittenScan, robot: str = "go1") -> WrittenScan:
    """Return a written scene with what `scenes check` measures and finds; an error is its fault."""
    (checked,) = check_scenes([str(written.folder)], robot=robot)
    survey = checked.survey
    measured = () if survey is None else (*survey_lines(survey), *footing_lines(survey))
    errors = [one for one in checked.findings if one.severity == "error"]
    fault = written.fault
    if fault is None and errors:
        fault = f"{errors[0].message}; {errors[0].fix or 'see above'}"
    findings = (f"check: {one}" for one in (*measured, *checked.findings))
    return replace(written, lines=(*written.lines, *findings), fault=fault)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Scan:
    painted: PaintedMesh
    T_world_file: Values
    """(4, 4), but for the height of the floor."""
    fault: str | None
    """What contradicts about which way is up."""
    is_splat: bool = False
    """Whether its file holds Gaussians, which are its looks then."""


_SURFACES = (*MESH_SUFFIXES, *USD_SUFFIXES, *CLOUD_SUFFIXES)
_OF_MAPS = ("cell", "white", "black", "no_data")
_OF_MESHES = ("up", "unit", "gaussians")


def _check_used(source: Path, options: ScanOptions) -> None:
    """Check that nothing is asked for that this file has no use for.

    Raises:
        UsageError: something is; all of it is named.
    """
    suffix, default = source.suffix.lower(), ScanOptions()

    def given(*names: str) -> str:
        asked = [one for one in names if getattr(options, one) != getattr(default, one)]
        return " and ".join(f"--{one.replace('_', '-')}" for one in asked)

    if suffix in _SURFACES and (wrong := given(*_OF_MAPS)):
        what, fix = "of elevation maps", f"give one of {', '.join(ELEVATION_SUFFIXES)}"
    elif suffix in ELEVATION_SUFFIXES and (wrong := given(*_OF_MESHES)):
        what = "of meshes: an elevation map has its height up, is in metres and has no colours"
        fix = "scale it by --cell, --white and --black"
    elif options.splat is None and (wrong := given("splat_transform")):
        what, fix = "of a splat, and there is none", "name it with --splat"
    elif options.splat is not None and (wrong := given("gaussians")):
        what, fix = "of the mesh's colours, which --splat replaces", "leave out --splat"
    else:
        return
    verb = "are" if " and " in wrong else "is"
    raise UsageError(f"{source}: {wrong} {verb} {what}", fix=f"drop that, or {fix}")


def _read_scan(source: Path, options: ScanOptions) -> tuple[_Scan, list[str]]:
    suffix = source.suffix.lower()
    lines: list[str] = []
    fault, axes = None, suffix
    if suffix in ELEVATION_SUFFIXES:
        elevation = read_elevation(
            source,
            cell=options.cell,
            white=options.white,
            black=options.black,
            no_data=options.no_data,
        )
        rows, columns = elevation.heights.shape
        low, high = np.nanmin(elevation.heights), np.nanmax(elevation.heights)
        lines.append(
            f"elevation map: {columns} x {rows} pixels of {elevation.cell[0]:.3g} x "
            f"{elevation.cell[1]:.3g} m, heights {low:.3f} to {high:.3f} m"
        )
        lines += elevation.findings
        vertices, faces = elevation_mesh(elevation)
        if len(faces) == 0:
            raise SceneError(f"{source} has only holes", fix="check --no-data")
        painted = PaintedMesh(
            vertices=vertices,
            faces=faces,
            colours=None,
            uv=None,
            material=np.zeros(len(faces), np.int32),
            materials=(Material(),),
            findings=(),
        )
        T_file = np.eye(4)
    elif suffix in _SURFACES:
        if suffix in USD_SUFFIXES:
            painted, up, drawn = read_stage(source)
            axes = ".glb" if up == "+y" else ".las"
            lines += drawn
        elif is_cloud(source):
            painted, drawn = surfaced(source, options.up)
            lines += drawn
            if is_splat(source):
                axes = ".splat"
                lines.append(
                    "a splat alone: most are trained in a unit of their own, so compare the size "
                    "above with a length that you know; two clicks in `nw-eval twin label` scale it"
                )
        else:
            painted = read_painted(source)
        lines += [f"{one.message}" for one in painted.findings]
        T_file, words, fault = _upright(painted, axes, options)
        lines += words
    else:
        raise unread(source, (*_SURFACES, *ELEVATION_SUFFIXES))
    points = moved_points(T_file, painted.vertices)
    middle = np.median(points, axis=0)
    shift = np.where(np.abs(middle) > _FAR, -np.round(middle), 0.0)
    if shift.any():
        back = ", ".join(f"{value:.0f}" for value in -shift)
        lines.append(f"moved to the origin: ({back}) m subtracted")
    T = shifted(shift) @ T_file
    size = np.ptp(points, axis=0)
    words = f"{size[0]:.3g} x {size[1]:.3g} x {size[2]:.3g} m (x, y, z)"
    wide = float(size[:2].max())
    if wide > 2.0 * limits.REACH or wide < 0.3:
        raise SceneError(
            f"{source}: {words}: the unit of its numbers is not {_unit(painted, options)}",
            fix="give another --unit (m, cm, mm, ft, in)"
            if suffix in _SURFACES
            else "give another --cell",
        )
    lines.insert(0, f"{source.name}: {len(painted.faces):,} triangles, {words}")
    if wide > _ODDLY_WIDE:
        unit = _unit(painted, options)
        lines.append(f"it is {wide:.0f} m wide: if its numbers are no {unit}, give --unit")
    return _Scan(painted=painted, T_world_file=T, fault=fault, is_splat=axes == ".splat"), lines


def shifted(offset: Values) -> Values:
    """Return the (4, 4) shift by an offset (3,), m."""
    T = np.eye(4)
    T[:3, 3] = offset
    return T


def _unit(painted: PaintedMesh, options: ScanOptions) -> Unit:
    """Return the unit of a mesh's numbers: as told, or as its file says, or the metre."""
    if options.unit != "auto":
        return options.unit
    return next((unit for unit in get_args(Unit) if unit == painted.unit), "m")


def _upright(
    painted: PaintedMesh, suffix: str, options: ScanOptions
) -> tuple[Values, list[str], str | None]:
    """Return (4, 4) from file to metres with z up, which way is up by what, and what is at odds.

    The last is None where nothing is. The suffix is that of a format with the axes of the file.
    """
    solved = up_of_mesh(painted.vertices.astype(np.float64), painted.faces, suffix)
    up = solved.up if options.up == "auto" else AXES[options.up]
    near = max(AXES, key=lambda name: float(AXES[name] @ up))
    unit = _unit(painted, options)
    scale = UNITS[unit]
    T = np.eye(4)
    T[:3, :3] = scale * turn_to_z(up)
    corners = painted.vertices[painted.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    share = float(area[normal @ up > _LEVEL * area].sum() / max(float(area.sum()), 1e-300))
    which = f"{near} of the file"
    if not np.array_equal(up, AXES[near]):
        x, y, z = up.tolist()
        off = math.degrees(math.acos(min(1.0, float(up @ AXES[near]))))
        which = f"({x:.3f}, {y:.3f}, {z:.3f}) of the file, {off:.1f} degrees from {near}"
    lines = [
        f"up is {which}: {100 * share:.0f} % of its area faces along it; one unit is {scale:g} m"
    ]
    fault = None
    if options.up == "auto":
        lines.append(f"up is known to {solved.uncertain:.1f} degrees (95 %)")
        if suffix == ".glb" and near != "+y":
            lines.append("its format has +y up: the planes of this file contradict it")
        if solved.uncertain > _SURE:
            likely = [f"{one} {share:.0%}" for one, share in solved.axes.items() if share >= 0.005]
            fault = (
                f"up is known to {solved.uncertain:.0f} degrees only: within 20 degrees of "
                f"{', '.join(likely) or 'no axis'}; give --up {near} if that is right, or {_FLOOR}"
            )
    elif solved.axes.get(options.up, 0.0) < 0.5:
        first, probable = next(iter(solved.axes.items()))
        lines.append(f"by its planes, and what stands on them, up is {first} ({probable:.0%})")
    room = room_of(corners, up)
    if painted.unit not in (None, unit):
        lines.append(f"the file gives its unit as {painted.unit}, and it is read as {unit}")
    if room is not None and not _ROOMS[0] <= scale * room.height <= _ROOMS[1]:
        lines.append(
            f"a ceiling is {scale * room.height:.2f} m above the floor: if that is a room, its "
            f"numbers may not be {unit}; give --unit"
        )
    return T, lines, fault


def turn_to_z(up: Values) -> Values:
    """Return the (3, 3) shortest turn of a unit vector to +z; of -z, the half turn about x."""
    x, y, z = up.tolist()
    if z < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    k = 1.0 / (1.0 + z)
    return np.array(
        [[1.0 - k * x * x, -k * x * y, -x], [-k * x * y, 1.0 - k * y * y, -y], [x, y, z]]
    )


def _mesh_of(scan: _Scan, T: Values) -> TriangleMesh:
    return TriangleMesh(
        vertices=moved_points(T, scan.painted.vertices),
        faces=np.ascontiguousarray(scan.painted.faces, dtype=np.int32),
        kinds=np.full(len(scan.painted.faces), FACE_KINDS.index("ground"), np.uint8),
    )


# --- The course ---------------------------------------------------------------------------------


def lay_course(
    mesh: TriangleMesh, trail: Sequence[tuple[float, ...]] | None, task: Task | None
) -> tuple[Route, list[str], str | None]:
    """Return start and waypoints on the ground of a mesh, what is said of them, and their fault.

    The fault is why no robot can start there, and what to do; None = one can.
    """
    rays = RayScene(mesh)
    ground = walkable(mesh, rays)
    # A roof is larger than what a robot reaches below it.
    room = room_of(mesh.triangles, np.array([0.0, 0.0, 1.0]))
    region = ground.largest(None if room is None else room.floor)
    if trail is not None:
        floor = float(np.median(mesh.vertices[:, 2])) if region is None else ground.height(region)
        route, words = _given(mesh, rays, floor, trail, task or "open")
    else:
        course, reach = None, 0.0
        if region is not None:
            course, reach = _proposed(mesh, rays, ground, region)
        if course is None:
            fault = f"no course: {_why_none(ground, region, reach)}: it is one waypoint ahead"
            return _placeholder(mesh, task or "open"), [], f"{fault}; {_FLOOR}"
        route, words = _straight(mesh, rays, *course, task or "open")
    tilt = _tilt(mesh, rays, route)
    if tilt < _INCLINED:
        return route, [words], None
    fault = f"the ground at the start is inclined by {math.degrees(tilt):.0f} degrees"
    if math.cos(tilt) < _LEVEL:
        return route, [words], f"{fault}: {_FLOOR}"
    return route, [words, f"{fault}; if it is level in truth, {_FLOOR}"], None


def _why_none(ground: Walkable, region: int | None, reach: float) -> str:
    if region is None:
        return "a robot fits nowhere: no surface of 0.4 x 0.4 m faces up with headroom above it"
    x, y, _ = ground.points[ground.region == region].mean(axis=0).tolist()
    return (
        f"the largest ground on which a robot fits, {ground.areas[region]:.1f} m2 about "
        f"({x:.1f}, {y:.1f}), has {max(reach, 0.0):.1f} m straight, and 1 m is needed with "
        f"{_BEHIND:g} m before and behind it"
    )


_FLOOR = (
    "level the floor, `nw-eval scenes level SCENE --floor X,Y,Z X,Y,Z X,Y,Z --propose`, or import "
    "with another --up or --unit"
)


def _tilt(mesh: TriangleMesh, rays: RayScene, route: Route) -> float:
    """Return how far the ground within half a metre of the start is inclined, rad.

    It is the median of all 10 cm, so that steps and stairs of level treads do not count.
    """
    x, y, z = route.spawn
    side = np.linspace(-0.5, 0.5, 11)
    xy = np.stack(np.meshgrid(x + side, y + side), axis=-1).reshape(-1, 2)
    ground = _ground(mesh, rays, xy, np.array([[x, y, z]])).reshape(11, 11)
    rises = [np.diff(ground, axis=axis) / 0.1 for axis in (0, 1)]
    known = [each[np.isfinite(each)] for each in rises]
    return math.atan(math.hypot(*(float(np.median(one)) if len(one) else 0.0 for one in known)))


def _straight(
    mesh: TriangleMesh, rays: RayScene, points: Values, yaw: float, task: Task
) -> tuple[Route, str]:
    """Return a proposed way (K, 3) as a course, and what is said of it and its ground."""
    far = float(np.linalg.norm(points[-1, :2] - points[0, :2]))
    course = Route(
        task=task,
        trail=points[1:],
        spawn=(float(points[0, 0]), float(points[0, 1]), float(points[0, 2])),
        yaw=yaw,
    )
    x, y, _ = course.spawn
    share = np.linspace(0.0, 1.0, max(round(far / _STRIDE), 1) + 1)[:, None]
    ground = _ground(mesh, rays, points[0, :2] * (1 - share) + points[-1, :2] * share, points)
    known = ground[np.isfinite(ground)]
    rises = np.diff(known)
    even = np.ptp(known) <= _EVEN
    kind = "even ground" if even else "uneven ground"
    return course, (
        f"course proposed: {far:.1f} m straight over {kind} from ({x:.2f}, {y:.2f}), heading "
        f"{math.degrees(yaw):.0f} degrees: it rises by {rises[rises > 0].sum():.2f} m and falls by "
        f"{np.abs(rises[rises < 0]).sum():.2f} m in all, at most "
        f"{np.abs(rises).max(initial=0.0):.2f} m within {_STRIDE:g} m; "
        "`--trail` or `nw-eval twin label` sets another"
    )


def _placeholder(mesh: TriangleMesh, task: Task) -> Route:
    """Return a start at the middle of a mesh that shows no floor yet, and one waypoint ahead."""
    middle = np.median(mesh.vertices, axis=0)
    x, y, z = mesh.vertices[np.linalg.norm(mesh.vertices - middle, axis=1).argmin()].tolist()
    return Route(task=task, trail=np.array([[x + 1.0, y, z]]), spawn=(x, y, z))


def _given(
    mesh: TriangleMesh,
    rays: RayScene,
    reference: float,
    trail: Sequence[tuple[float, ...]],
    task: Task,
) -> tuple[Route, str]:
    if len(trail) < 2 or len(trail) > limits.WAYPOINTS + 1:
        raise UsageError(
            f"--trail has {len(trail)} points",
            fix="give the start and then the waypoints: --trail 0,0 1.5,0 3,0",
        )
    points: list[Values] = []
    for i, point in enumerate(trail):
        z = reference if len(point) == 2 else point[2]
        ground = float(_ground(mesh, rays, np.array([point[:2]]), np.array([[*point[:2], z]]))[0])
        if not math.isfinite(ground):
            ground = float(rays.height(np.array([point[:2]]))[0])
        if not math.isfinite(ground):
            low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
            raise SceneError(
                f"{'the start' if i == 0 else f'waypoint {i - 1}'} at "
                f"({point[0]:g}, {point[1]:g}) has no ground under it",
                fix=f"the mesh reaches from ({low[0]:.2f}, {low[1]:.2f}) to "
                f"({high[0]:.2f}, {high[1]:.2f})",
            )
        points.append(np.array([*point[:2], ground]))
        reference = ground
    first, second = points[0], points[1]
    if np.linalg.norm(second[:2] - first[:2]) < 1e-6:
        raise UsageError("the first waypoint is the start", fix="give one ahead of it")
    course = Route(
        task=task,
        trail=np.array(points[1:]),
        spawn=(float(first[0]), float(first[1]), float(first[2])),
        yaw=math.atan2(second[1] - first[1], second[0] - first[0]),
    )
    return course, f"course of {len(points) - 1} waypoints, laid on the ground as given"


def _ground(mesh: TriangleMesh, rays: RayScene, xy: Values, course: Values) -> Values:
    """Return the ground (N,) of a course (K, 3), m, as terrain has it; nan where there is none."""
    from nw_scenes.grid import TerrainOptions

    return Surface(mesh, course, TerrainOptions(), rays).ground(xy)


def _proposed(
    mesh: TriangleMesh, rays: RayScene, ground: Walkable, number: int
) -> tuple[tuple[Values, float] | None, float]:
    """Return start and waypoints (K, 3) of the longest straight way, and its yaw; and its length.

    It is in a region on which a robot fits, with headroom along it. Of equally long ways it is the
    most even, and of these that along x or y which leads over the middle of the region.
    """
    floor = ground.height(number)
    region = ground.points[ground.region == number]
    low, high = region[:, :2].min(axis=0), region[:, :2].max(axis=0)
    spread = max(float((high - low).max()) / 24.0, 0.25)
    squares = np.floor((region[:, :2] - low) / spread).astype(np.int64)
    starts = region[np.unique(squares, axis=0, return_index=True)[1]]
    along = np.arange(-_BEHIND, _LONGEST + _BEHIND + _STRIDE / 2, _STRIDE)
    aside = np.array([-_ROOM, 0.0, _ROOM])
    first = round(_BEHIND / _STRIDE)
    best: tuple[float, Values, float] | None = None
    longest, middle = 0.0, (low + high) / 2
    for turn in range(16):
        yaw = 2.0 * math.pi * turn / 16
        ahead = np.array([math.cos(yaw), math.sin(yaw)])
        left = np.array([-ahead[1], ahead[0]])
        steps = along[:, None, None] * ahead + aside[None, :, None] * left
        xy = starts[:, None, None, :2] + steps[None]
        z = _followed(rays, xy, starts[:, 2], first)
        even = np.abs(np.diff(z, axis=1)) < _STEP  # False beside what is not there.
        even &= np.isfinite(z[:, 1:]) & np.isfinite(z[:, :-1])
        places = np.concatenate([xy, np.nan_to_num(z)[..., None] + _FOOT], axis=-1).reshape(-1, 3)
        room = rays.distance(places, np.tile([0.0, 0.0, 1.0], (len(places), 1)))
        even &= (room.reshape(z.shape) > _HEADROOM)[:, 1:]
        whole = np.logical_and.accumulate(even.all(axis=2), axis=1)
        reach = whole.sum(axis=1) * _STRIDE - 2 * _BEHIND
        # Along the course itself a robot fits: through a wall that is a sheet it does not.
        line = xy[:, first:, 1]
        fits = np.isfinite(ground.under(number, line.reshape(-1, 2))).reshape(line.shape[:2])
        reach = np.minimum(reach, np.logical_and.accumulate(fits, axis=1).sum(axis=1) * _STRIDE)
        longest = max(longest, float(reach.max()))
        away = np.linalg.norm(starts[:, :2] + _LONGEST / 2 * ahead - middle, axis=1)
        course = z[:, first : first + round(_LONGEST / _STRIDE), 1]
        course = np.where(whole[:, first : first + course.shape[1]], course, np.nan)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # All of a row is nan.
            bumps = np.nan_to_num(np.nanmax(course, axis=1) - np.nanmin(course, axis=1))
        bumps = np.where(bumps > _EVEN, bumps, 0.0)
        # A bench may be longer than the floor before it.
        off = np.abs(np.nan_to_num(z[:, first, 1]) - floor)
        off = np.clip(2.0 * (off / _ON_FLOOR - 1.0), 0.0, 6.0)
        score = np.floor(reach / 0.5) - _BUMPY * bumps - off
        score -= 1e-3 * away + 1e-2 * (turn % 4 != 0)
        for i in np.argsort(-score, kind="stable")[:_TRIED].tolist():
            worth = float(score[i])
            if reach[i] < 1.0 or (best is not None and worth <= best[0]):
                break
            length = min(float(reach[i]), _LONGEST)
            count = max(int(length // 1.0), 1)
            places = np.concatenate([[0.0], np.linspace(length / count, length, count)])
            rows = first + np.round(places / _STRIDE).astype(np.int64)
            points = np.column_stack([xy[i, rows, 1], z[i, rows, 1]])
            spawn = Spawn(position=(*points[0].tolist(),), yaw=yaw)
            holes, _ = holes_along(mesh, spawn, points[1:], HALF_WIDTH, _BEHIND)
            line = slice(first - first // 2, int(rows[-1]) + first + 1)
            touched = _ground(mesh, rays, xy[i, line].reshape(-1, 2), points)
            as_seen = np.abs(touched - z[i, line].ravel()) <= _AS_SEEN  # False where there is none.
            is_whole = not len(holes) and bool(as_seen.all())
            # A course without holes, and with nothing over it, is better, however short.
            worth -= 0.0 if is_whole else _HOLED
            if best is None or worth > best[0]:
                best = (worth, points, yaw)
            if is_whole:
                break
    return (None if best is None else best[1:]), longest


def _followed(rays: RayScene, xy: Values, heights: Values, first: int) -> Values:
    """Return the ground (S, L, A) on ways over points (S, L, A, 2), followed from their starts.

    Args:
        rays: of the mesh.
        xy: of the ways, `_STRIDE` apart, and beside them.
        heights: (S,) of the ground at the starts, m.
        first: number of the start among the points of a way.
    """
    z = np.full(xy.shape[:3], np.nan)
    for order in (range(first, xy.shape[1]), range(first - 1, -1, -1)):
        above = np.where(np.isfinite(z[:, first, 1]), z[:, first, 1], heights)
        for place in order:
            points, start = xy[:, place].reshape(-1, 2), np.repeat(above + _STEP, xy.shape[2])
            found = rays.height(points, z_from=start).reshape(-1, xy.shape[2])
            z[:, place] = np.where(np.isfinite(found), found, np.nan)
            above = np.where(np.isfinite(z[:, place, 1]), z[:, place, 1], above)
    return z
