"""OpenMVS, where its programs are installed: they are called, nothing of them is in here.

It reads a capture as a COLMAP model in text. Its mesh comes without depth maps and colours of ours:
they are what the shots show of it.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nw_eval.errors import PrerequisiteError, SceneError
from nw_eval.files.cache import atomic_path
from nw_eval.scenes.mesh import FACE_KINDS, TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.splat.camera import Camera
from nw_eval.twin.capture import Capture, read_picture
from nw_eval.twin.reconstruct.depth import DepthMap
from nw_eval.twin.reconstruct.mesh import ColourMesh, read_colour_mesh
from nw_eval.twin.reconstruct.views import F32, WorkingView, read_view

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
        for place, point in enumerate(shot.seen):
            tracks[point].append(f"{number} {place}")
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
    found: list[DepthMap] = []
    for shot in capture.shots:
        view = read_view(shot, folder, side)
        depth = _depth(view, rays)
        if view.mask is not None:
            depth = np.where(view.mask, depth, np.float32(0.0))
        sure, normal = (depth > 0).astype(np.float32), normals_of(depth, view)
        found.append(DepthMap(view=view, depth=depth, confidence=sure, normal=normal))
        say(f"depth of {view.name}: {len(found)} of {len(capture.shots)}")
    return found


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
