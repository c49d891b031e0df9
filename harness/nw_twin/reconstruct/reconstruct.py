"""A capture to depth maps and a mesh, with a report.

OpenMVS does it where its programs are installed: they are called, nothing of them is in here. It
reads a capture as a COLMAP model in text. Its mesh comes without depth maps and colours of ours:
they are what the shots show of it.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nw_base.errors import PrerequisiteError, SceneError, UsageError
from nw_base.files.cache import atomic_path
from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.rays import RayScene
from nw_splat.camera import Camera
from nw_twin.capture import Capture, read_capture, read_picture
from nw_twin.options import Engine, ReconstructOptions
from nw_twin.reconstruct.clean import (
    ROOM,
    FlatPlane,
    Hole,
    PartsKept,
    flatten,
    flatten_small,
    holes,
    large_parts,
    on_planes,
    simplify,
)
from nw_twin.reconstruct.depth import DepthMap, depth_maps, near_of, write_map
from nw_twin.reconstruct.planar import planar_maps
from nw_twin.reconstruct.planes import SupposedPlane, hypotheses
from nw_twin.reconstruct.surface import (
    ColourMesh,
    read_colour_mesh,
    surface,
    voxel_of,
    write_mesh,
)
from nw_twin.reconstruct.views import F32, WorkingView, read_view

PROGRAMS = ("InterfaceCOLMAP", "DensifyPointCloud", "ReconstructMesh")
_LAST = 4096
"""Bytes of a log in which its last line is looked for."""

_HIDDEN = 0.01
"""Share of its depth by which a vertex may lie behind the surface and be seen."""


def openmvs_mesh(
    capture: Capture, folder: Path, work: Path, say: Callable[[str], None], threads: int = 2
) -> ColourMesh:
    """Return OpenMVS's mesh of a capture; it has no colours.

    Args:
        capture: as read from its folder.
        folder: of the capture.
        work: a folder that the programs work in, beside their logs `<program>.log`.
        say: is told which program runs.
        threads: that the programs may use.

    Raises:
        PrerequisiteError: a program is not on PATH.
        SceneError: a program fails or leaves no mesh; a picture cannot be read.
        StoreError: a file cannot be written.
    """
    paths = {name: shutil.which(name) for name in PROGRAMS}
    missing = [name for name, path in paths.items() if path is None]
    if missing:
        raise PrerequisiteError(
            f"not on PATH: {', '.join(missing)}",
            fix="install OpenMVS, or reconstruct with the engine patchmatch",
        )
    work = work.resolve()
    write_colmap_model(capture, folder, work / "colmap")
    shared = ["-w", str(work), "--max-threads", str(threads)]
    images = str(work / "colmap" / "images")
    arguments = {
        "InterfaceCOLMAP": [
            "-w", str(work), "-i", str(work / "colmap"), "-o", "scene.mvs",
            "--image-folder", images,
        ],
        "DensifyPointCloud": [*shared, "-i", "scene.mvs", "-o", "dense.mvs"],
        "ReconstructMesh": [*shared, "-i", "dense.mvs", "-o", "mesh.mvs"],
    }  # fmt: skip
    mesh = work / "mesh.ply"
    mesh.unlink(missing_ok=True)  # What an earlier run left is no result of this one.
    for name, path in paths.items():
        say(f"runs {name}")
        _run(str(path), arguments[name], work, name)
    if not mesh.is_file():
        raise SceneError(
            f"{PROGRAMS[-1]} ended well and wrote no {mesh.name}",
            fix=f"read {work / PROGRAMS[-1]}.log",
        )
    return read_colour_mesh(mesh)


def _run(program: str, arguments: list[str], work: Path, name: str) -> None:
    log = work / f"{name}.log"
    with log.open("wb") as file:
        try:
            done = subprocess.run(  # noqa: S603  # A list of arguments, no shell.
                [program, *arguments],
                cwd=work,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                check=False,
            )
        except OSError as error:
            raise SceneError(
                f"{program} cannot be run: {error.strerror}", fix="install OpenMVS again"
            ) from None
    if done.returncode != 0:
        lines = log.read_bytes()[-_LAST:].decode(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "nothing")
        raise SceneError(
            f"{name} failed with {done.returncode}; it said last: {last}", fix=f"read {log}"
        )


def write_colmap_model(capture: Capture, folder: Path, out: Path) -> None:
    """Write `out/sparse/{cameras,images,points3D}.txt` and `out/images/`.

    Pictures get numbers for names: whatever a shot is called, the file stays a line of words.
    COLMAP's first pixel has its centre at (0.5, 0.5), as ours.

    Raises:
        SceneError: a picture cannot be read.
        StoreError: a file cannot be written.
    """
    cameras: list[str] = []
    images: list[str] = []
    tracks: list[list[str]] = [[] for _ in capture.points]
    for number, shot in enumerate(capture.shots, 1):
        camera, name = shot.camera, f"{number:06d}.png"
        with atomic_path(out / "images" / name) as temporary:
            Image.fromarray(read_picture(shot, folder)).save(temporary)
        lens = " ".join(f"{v:.17g}" for v in (camera.fx, camera.fy, camera.cx, camera.cy))
        cameras.append(f"{number} PINHOLE {camera.width} {camera.height} {lens}")
        T = camera.T_camera_world
        pose = " ".join(f"{v:.17g}" for v in (*_quaternion(T[:3, :3]), *T[:3, 3]))
        shown = _projected(camera, capture.points[shot.seen])
        images += [
            f"{number} {pose} {number} {name}",
            " ".join(
                f"{u:.6f} {v:.6f} {p + 1}" for (u, v), p in zip(shown, shot.seen, strict=True)
            ),
        ]
        for index, point in enumerate(shot.seen):
            tracks[point].append(f"{number} {index}")
    points = [
        f"{n} {x:.17g} {y:.17g} {z:.17g} {r} {g} {b} {error:.6g} {' '.join(track)}"
        for n, ((x, y, z), (r, g, b), error, track) in enumerate(
            zip(capture.points, capture.colours, capture.errors, tracks, strict=True), 1
        )
        if track
    ]
    for file, lines in (("cameras", cameras), ("images", images), ("points3D", points)):
        with atomic_path(out / "sparse" / f"{file}.txt") as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="ascii")


def _projected(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    T = camera.T_camera_world
    x, y, z = (points @ T[:3, :3].T + T[:3, 3]).T
    return np.column_stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


def _quaternion(R: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return the quaternion wxyz of a rotation (3, 3): the eigenvector of Bar-Itzhack (2000)."""
    K = np.array(
        [
            [R[0, 0] - R[1, 1] - R[2, 2], 0.0, 0.0, 0.0],
            [R[0, 1] + R[1, 0], R[1, 1] - R[0, 0] - R[2, 2], 0.0, 0.0],
            [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], R[2, 2] - R[0, 0] - R[1, 1], 0.0],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], np.trace(R)],
        ]
    )
    x, y, z, w = (float(part) for part in np.linalg.eigh(K)[1][:, -1])
    sign = -1.0 if w < 0.0 else 1.0
    return sign * w, sign * x, sign * y, sign * z


def maps_of(
    mesh: ColourMesh, capture: Capture, folder: Path, side: int, say: Callable[[str], None]
) -> list[DepthMap]:
    """Return each shot's depth as the mesh has it; confidence is 1 where there is a surface.

    Raises:
        SceneError: a picture cannot be read.
    """
    kinds = np.full(len(mesh.faces), FACE_KINDS.index("ground"), np.uint8)
    rays = RayScene(TriangleMesh(vertices=mesh.vertices, faces=mesh.faces, kinds=kinds))
    maps: list[DepthMap] = []
    for shot in capture.shots:
        view = read_view(shot, folder, side)
        depth = _depth(view, rays)
        if view.mask is not None:
            depth = np.where(view.mask, depth, np.float32(0.0))
        sure, normal = (depth > 0).astype(np.float32), normals_of(depth, view)
        maps.append(DepthMap(view=view, depth=depth, confidence=sure, normal=normal))
        say(f"depth of {view.name}: {len(maps)} of {len(capture.shots)}")
    return maps


def _depth(view: WorkingView, rays: RayScene) -> F32:
    height, width = view.size
    x, y = np.meshgrid(
        (np.arange(width) + 0.5 - view.K[0, 2]) / view.K[0, 0],
        (np.arange(height) + 0.5 - view.K[1, 2]) / view.K[1, 1],
    )
    ahead = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    length = np.linalg.norm(ahead, axis=1)
    T = np.linalg.inv(view.T_camera_world)
    directions = ahead / length[:, None] @ T[:3, :3].T
    distance = rays.distance(np.broadcast_to(T[:3, 3], directions.shape), directions)
    depth = np.where(np.isfinite(distance), distance, 0.0) / length
    return depth.reshape(height, width).astype(np.float32)


def normals_of(depth: F32, view: WorkingView) -> F32:
    """Return the normals of a map's surface by what lies beside each pixel, (H, W, 3) float32.

    They are in the camera's frame and turned to it; 0 where depth is not known.
    """
    height, width = depth.shape
    x, y = np.meshgrid(
        (np.arange(width) + 0.5 - view.K[0, 2]) / view.K[0, 0],
        (np.arange(height) + 0.5 - view.K[1, 2]) / view.K[1, 1],
    )
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    down, across = np.gradient(rays * depth[..., None], axis=(0, 1))
    normal = np.cross(across, down)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    normal *= np.where((normal * rays).sum(axis=-1) > 0.0, -1.0, 1.0)[..., None]
    return np.where(depth[..., None] > 0, normal, 0.0).astype(np.float32)


def coloured(mesh: ColourMesh, maps: list[DepthMap]) -> ColourMesh:
    """Return the mesh with each vertex in the mean colour of the shots that see it; else grey."""
    total, count = np.zeros((len(mesh.vertices), 3)), np.zeros(len(mesh.vertices))
    for each in maps:
        view, T = each.view, each.view.T_camera_world
        local = mesh.vertices @ T[:3, :3].T + T[:3, 3]
        z = np.where(local[:, 2] > 0.0, local[:, 2], np.inf)
        u = view.K[0, 0] * local[:, 0] / z + view.K[0, 2]
        v = view.K[1, 1] * local[:, 1] / z + view.K[1, 2]
        height, width = view.size
        rows = np.flatnonzero(np.isfinite(z) & (u >= 0) & (u < width) & (v >= 0) & (v < height))
        x, y = u[rows].astype(np.int64), v[rows].astype(np.int64)
        seen = z[rows] <= each.depth[y, x] * (1.0 + _HIDDEN)
        rows, x, y = rows[seen], x[seen], y[seen]
        total[rows] += view.rgb[y, x]
        count[rows] += 1.0
    colours = np.where(count[:, None] > 0, total / np.maximum(count, 1.0)[:, None], 128.0)
    return ColourMesh(
        vertices=mesh.vertices, faces=mesh.faces, colours=np.round(colours).astype(np.uint8)
    )


_MOST_SAMPLES = 2_000_000
"""Points of the surface that there may be; each takes about 1 kB."""
_LISTED_HOLES = 50

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class ReconstructReport:
    """Figures of a reconstruction; lengths in the capture's unit, places in its frame.

    Attributes:
        engine: that made the surface.
        shots: of the capture.
        without_depth: names of those of whose depth nothing is known.
        coverage: mean share of a picture whose depth is known.
        confidence: its mean where depth is known.
        voxel: edge of a voxel, or for OpenMVS the typical length of an edge.
        vertices: of mesh.ply.
        faces: of mesh.ply.
        faces_before: as the surface came, before it was cleaned.
        area: of mesh.ply.
        parts: what became of loose parts.
        planes: that were made flat, the largest first.
        holes: borders of the surface, the longest first; the first is usually its rim.
        all_holes: how many borders there are; the shortest are not listed.
    """

    engine: Engine
    shots: int
    without_depth: tuple[str, ...]
    coverage: float
    confidence: float
    voxel: float
    vertices: int
    faces: int
    faces_before: int
    area: float
    parts: PartsKept
    planes: tuple[FlatPlane, ...]
    holes: tuple[Hole, ...]
    all_holes: int

    def lines(self) -> list[str]:
        """Return the report in plain words."""
        flat = sum(plane.area * plane.moved for plane in self.planes)
        parts, voxel = self.parts, f"{self.engine}, voxel {self.voxel:.4g}"
        known = f"depth known for {self.coverage:.0%} of their pixels"
        lines = [
            f"{self.shots} shots, {known} at a mean confidence of {self.confidence:.2f}",
            f"{self.faces} faces of {self.faces_before} ({voxel}), area {self.area:.4g}",
            f"{parts.kept} parts kept, {parts.dropped} with {parts.dropped_area:.1%} dropped",
            f"{len(self.planes)} planes made flat, an area of {flat:.4g}",
        ]
        if self.without_depth:
            lines.append(f"no depth is known of {', '.join(self.without_depth)}")
        for hole in self.holes[1:6]:
            location = ", ".join(f"{v:.3g}" for v in hole.centre)
            lines.append(f"a hole of {hole.across:.3g} across at ({location})")
        return lines


def write_report(report: ReconstructReport, path: Path) -> None:
    """Write report.json.

    Raises:
        StoreError: the file cannot be written.
    """
    content = {"nw-reconstruct": 1, **asdict(report), "words": report.lines()}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def reconstruct(
    capture_folder: Path,
    out: Path,
    options: ReconstructOptions,
    say: Say,
    threads: int = 2,
) -> ReconstructReport:
    """Reconstruct the surface of a capture.

    Writes `out/depth/<shot>.npz` (depth along the optical axis, 0 where not known, and confidence,
    both (H, W) float32 of the picture's size, and normals (H, W, 3) float16 in the camera's frame),
    `out/mesh.ply` and, last, `out/report.json`. A call
    that was cut short is taken up by the next one with the same capture and options.

    Args:
        capture_folder: of `nw_twin.capture`.
        out: a folder for the results, made if it is not there.
        options: see there.
        say: receives progress messages.
        threads: at once; the results have the same bits with any number.

    Raises:
        SceneError: the capture cannot be read, or shows too little to measure any depth; or a
            program of OpenMVS fails.
        UsageError: fewer than one thread.
        PrerequisiteError: a package or a program is missing.
        StoreError: a file cannot be written.
    """
    if threads < 1:
        raise UsageError(f"threads is {threads}", fix="give 1 or more")
    capture = read_capture(capture_folder)
    if options.engine == "openmvs":
        maps, whole, voxel = _by_openmvs(capture, capture_folder, out, options, say, threads)
        supposed: list[SupposedPlane] = []
    else:
        maps, supposed, voxel = _by_patchmatch(capture, capture_folder, out, options, say, threads)
        whole = surface(maps, voxel, _MOST_SAMPLES, say)
    for each in maps:
        write_map(capture, each, out)
    say(f"cleans {len(whole.faces)} faces")
    flat, planes = flatten(whole, voxel, supposed)
    flat, small = flatten_small(flat, planes, supposed, voxel)
    both = [turned for plane in supposed for turned in (plane, plane.turned())]
    islands = on_planes(flat, [*planes, *both], voxel)
    kept, parts = large_parts(flat, options.least_part, islands, ROOM * voxel**2)
    mesh = simplify(kept, options.faces)
    borders = holes(mesh)
    write_mesh(mesh, out / "mesh.ply")
    known = [each.confidence[each.depth > 0] for each in maps]
    with_depth = {each.view.name for each, some in zip(maps, known, strict=True) if len(some)}
    report = ReconstructReport(
        engine=options.engine,
        shots=len(capture.shots),
        without_depth=tuple(s.name for s in capture.shots if s.name not in with_depth),
        coverage=sum(float((m.depth > 0).mean()) for m in maps) / len(capture.shots),
        confidence=float(np.concatenate(known).mean()),
        voxel=voxel,
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        faces_before=len(whole.faces),
        area=0.5 * float(np.linalg.norm(mesh.normals, axis=1).sum()),
        parts=parts,
        planes=(*planes, *small),
        holes=tuple(borders[:_LISTED_HOLES]),
        all_holes=len(borders),
    )
    write_report(report, out / "report.json")
    for line in report.lines():
        say(line)
    return report


def _by_patchmatch(
    capture: Capture, folder: Path, out: Path, options: ReconstructOptions, say: Say, threads: int
) -> tuple[list[DepthMap], list[SupposedPlane], float]:
    """Return the depth maps, the planes that they may show, and the edge of a voxel."""
    maps = depth_maps(capture, folder, out, options.depth, say, threads)
    voxel = options.voxel or voxel_of(maps)
    planes = hypotheses(surface(maps, voxel, _MOST_SAMPLES, say), maps, voxel)
    say(f"{len(planes)} planes may be there")
    near = near_of(capture, maps, options.depth)
    return planar_maps(maps, near, planes, say, threads), planes, voxel


def _by_openmvs(
    capture: Capture, folder: Path, out: Path, options: ReconstructOptions, say: Say, threads: int
) -> tuple[list[DepthMap], ColourMesh, float]:
    mesh = openmvs_mesh(capture, folder, out / "openmvs", say, threads)
    maps = maps_of(mesh, capture, folder, options.depth.side, say)
    if not any((each.depth > 0).any() for each in maps):
        raise SceneError("no shot shows the mesh of OpenMVS", fix="read the logs in its folder")
    edges = mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)]
    voxel = options.voxel or float(np.median(np.linalg.norm(edges, axis=-1)))
    return maps, coloured(mesh, maps), voxel
