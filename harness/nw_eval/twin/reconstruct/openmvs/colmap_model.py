"""A capture as a COLMAP model in text, which OpenMVS reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nw_eval.files.cache import atomic_path
from nw_eval.splat.camera import Camera
from nw_eval.twin.capture import Capture, read_picture


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
