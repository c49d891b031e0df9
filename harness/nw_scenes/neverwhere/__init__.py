"""Published Neverwhere scenes, and LucidSim's parametric terrains, read in place.

scene = load_published("neverwhere:/data/real_scenes/hurdle_stata_v1")
inspection = inspect_published("/data/real_scenes/hurdle_stata_v1")
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.files.inside import what_is
from nw_base.words import ROBOTS, Collision
from nw_scenes.finding import SceneFinding, unreadable
from nw_scenes.folder import FileSplat
from nw_scenes.grid import TerrainOptions, trail_heights
from nw_scenes.limits import REACH, SOLIDS, WAYPOINTS, name_of
from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.neverwhere.files import Places, find_places, row_of
from nw_scenes.neverwhere.scan import SPLATS, Scan, is_scan, read_primitives, read_scan
from nw_scenes.neverwhere.tree import Tree, read_tree
from nw_scenes.scene import Plane, Scene, Spawn

PREFIX = "neverwhere:"
"""What a reference to a published scene begins with, in suites and on the command line."""

# The licence of the published data was not seen.
_LICENCE = "LicenseRef-Neverwhere"
_SPAWN = np.zeros(3)
# The published robot starts 0.4 m above z = 0 whatever lies there. Within this of 0, so does ours;
# beyond, it starts above the floor that there is, and the check says so.
_FLOOR_TOLERANCE = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Inspection:
    """A scene, if it could be read, and all that was found.

    Attributes:
        scene: None if it could not be read: then `findings` says why.
        findings: errors first.
    """

    scene: Scene | None
    findings: tuple[SceneFinding, ...]


def load_published(
    reference: str | Path, *, robot: str = "go1", collision: Collision = "terrain"
) -> Scene:
    """Return a published scene.

    Args:
        reference: `neverwhere:<path>` or the path: the scene folder, or its XML.
        robot: whose XML is read if there is one for each; they differ in nothing else.
        collision: `triangles` takes the collision mesh's own triangles, to check the terrain with.

    Raises:
        SceneError: a file is missing or wrong; the message names file, line and value.
    """
    return _load(find_places(reference_path(reference), robot), collision)[0]


def inspect_published(
    reference: str | Path, *, robot: str = "go1", collision: Collision = "terrain"
) -> Inspection:
    """Read a published scene and say all that is wrong or remarkable about it; raises nothing."""
    from nw_scenes.check import check_scene
    from nw_scenes.neverwhere.scan import consistency_findings

    try:
        places = find_places(reference_path(reference), robot)
        scene, load_findings = _load(places, collision)
        tree = read_tree(places)
        findings = [*load_findings, *_between_robots(places, tree)]
        if is_scan(tree):
            scan = read_scan(tree, places)
            shift = tree.bodies.get("collision_mesh", np.eye(4))[:3, 3]
            findings += consistency_findings(scan.visual, scan.collision, shift)
        findings += check_scene(scene)
    except SceneError as error:
        return Inspection(scene=None, findings=unreadable(error))
    order = ("error", "warning", "note")
    findings.sort(key=lambda finding: order.index(finding.severity))
    return Inspection(scene=scene, findings=tuple(findings))


def reference_path(reference: str | Path) -> Path:
    """Return the path of a reference, without its prefix."""
    return Path(str(reference).removeprefix(PREFIX))


def trail_of(tree: Tree, places: Places) -> NDArray[np.float64]:
    """Return the waypoints (K, 3): bodies whose names begin with `waypoint`, sorted as strings.

    So `waypoint-10` comes before `waypoint-2`, as it does in the published evaluation.

    Raises:
        SceneError: there is none, there are too many, or one is too far away.
    """
    names = sorted(name for name in tree.bodies if name.startswith("waypoint"))
    if not names:
        raise SceneError(f"{places.xml}: no body is called waypoint*", fix="label the scene")
    if len(names) > WAYPOINTS:
        raise SceneError(f"{places.xml}: {len(names)} waypoints", fix=f"{WAYPOINTS} at most")
    trail = np.array([tree.bodies[name][:3, 3] for name in names])
    for name, point in zip(names, trail, strict=True):
        if not np.abs(point).max() <= REACH:
            raise SceneError(
                f"{places.xml}: body {name!r} is at {point.tolist()}",
                fix=f"a waypoint lies within {REACH:g} m of the origin: check the unit",
            )
    return trail


def _load(places: Places, collision: Collision) -> tuple[Scene, list[SceneFinding]]:
    tree = read_tree(places)
    trail = trail_of(tree, places)
    row, published = row_of(places.name)
    findings: list[SceneFinding] = []
    if not published:
        findings.append(
            SceneFinding(
                code="task_guessed",
                severity="note",
                message=f"{places.name!r} is not in the published table; its name was taken to "
                f"mean {row.task}, with waypoint noise {row.waypoint_noise} m",
            )
        )
    read = _scan if is_scan(tree) else _parametric
    scene, read_findings = read(tree, places, trail, collision)
    return scene, findings + read_findings


def _scan(
    tree: Tree, places: Places, trail: NDArray[np.float64], collision: Collision
) -> tuple[Scene, list[SceneFinding]]:
    # Embree loads with it; listing scenes needs neither.
    from nw_scenes.terrain import compiled_terrain

    scan = read_scan(tree, places)
    options = TerrainOptions(collision=collision, friction=scan.friction)
    terrain = compiled_terrain(scan.collision, trail=trail, spawn=_SPAWN, options=options)
    floor = terrain.spawn_height
    z = 0.0 if np.isnan(floor) or abs(floor) <= _FLOOR_TOLERANCE else floor
    row, _ = row_of(places.name)
    scene = Scene(
        name=f"neverwhere/{name_of(places.name)}",
        task=row.task,
        title=f"published scan {places.name}",
        solids=terrain.solids,
        ground=Plane(z=terrain.floor, friction=scan.friction),
        trail=trail,
        static_mesh=_with_overhead(scan, trail, options),
        splat=FileSplat(path=scan.splats[0]) if scan.splats else None,
        spawn=Spawn(position=(0.0, 0.0, z)),
        waypoint_noise=row.waypoint_noise,
        T_world_splat=scan.T_world_splat,
        licence=_LICENCE,
    )
    return scene, [*terrain.findings, *_splat_findings(scan, places)]


def _splat_findings(scan: Scan, places: Places) -> list[SceneFinding]:
    """Return that there is no splat, or which of two is read."""
    if not scan.splats:
        return [
            SceneFinding(
                code="no_splat",
                severity="error",
                message=f"{places.folder}: there is neither {' nor '.join(SPLATS)}",
                fix="download one; without it only policies without camera sensors run",
            )
        ]
    if len(scan.splats) == 1:
        return []
    read, other = (path.name for path in scan.splats)
    message = f"{scan.splats[0].parent} holds {read} and {other}: {read} is read"
    return [SceneFinding(code="two_splats", severity="note", message=message)]


def _with_overhead(scan: Scan, trail: NDArray[np.float64], options: TerrainOptions) -> TriangleMesh:
    """Return the visual mesh with what hangs above the headroom marked, as roofs and crowns are."""
    mesh = scan.visual
    corners = mesh.triangles
    path = np.vstack([_SPAWN[None], trail])
    ceiling = trail_heights(path, corners[:, :, :2].mean(axis=1)) + options.headroom
    kinds = mesh.kinds.copy()
    kinds[corners[:, :, 2].min(axis=1) >= ceiling] = FACE_KINDS.index("overhead")
    return TriangleMesh(vertices=mesh.vertices, faces=mesh.faces, kinds=kinds)


def _parametric(
    tree: Tree, places: Places, trail: NDArray[np.float64], _collision: Collision
) -> tuple[Scene, list[SceneFinding]]:
    solid = [
        geom
        for geom in tree.geoms
        if geom.collides and not any(name.startswith("waypoint") for name in geom.bodies)
    ]
    if not solid:
        raise SceneError(f"{places.xml}: nothing in it can be touched", fix="it needs geoms")
    if len(solid) > SOLIDS:
        raise SceneError(f"{places.xml}: {len(solid)} solids", fix=f"{SOLIDS} at most")
    parts = read_primitives(solid)
    row, _ = row_of(places.name)
    return (
        Scene(
            name=f"neverwhere/{name_of(places.name)}",
            task=row.task,
            title=f"parametric terrain {places.name}",
            solids=parts.solids,
            ground=parts.ground,
            trail=trail,
            static_mesh=parts.mesh,
            splat=None,
            waypoint_noise=row.waypoint_noise,
            licence=_LICENCE,
        ),
        [],
    )


def _between_robots(places: Places, tree: Tree) -> list[SceneFinding]:
    """Return whether the XML of the other robot places anything else."""
    findings: list[SceneFinding] = []
    for robot in ROBOTS:
        xml = places.xml.with_name(f"nw-{robot}-{places.name}.xml")
        if what_is(xml) != "file" or xml == places.xml:
            continue
        other = read_tree(Places(xml=xml, folder=places.folder, name=places.name))
        differing = sorted(
            name
            for name in tree.bodies.keys() | other.bodies.keys()
            if name not in tree.bodies
            or name not in other.bodies
            or not np.array_equal(tree.bodies[name], other.bodies[name])
        )
        scales = [
            each.meshes[name].get("scale") if name in each.meshes else None
            for each in (tree, other)
            for name in ("visual_mesh",)
        ]
        if differing or scales[0] != scales[1]:
            what = ", ".join(differing[:5]) or f"the mesh scale ({scales[0]} and {scales[1]})"
            findings.append(
                SceneFinding(
                    code="xml_disagree",
                    severity="warning",
                    message=f"{places.xml.name} and {xml.name} place differently: {what}",
                    fix="take both from one release",
                )
            )
    return findings
