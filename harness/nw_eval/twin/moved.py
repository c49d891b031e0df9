"""An alignment at work: points, meshes and cameras in metres.

A scene need not move its splat: `scene.yaml` has a similarity from splat to world, which leaves the
file as its trainer wrote it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import FACE_KINDS, FaceKind, TriangleMesh
from nw_eval.scenes.neverwhere.scan import check_similarity
from nw_eval.splat.camera import Camera
from nw_eval.splat.transform import quaternions
from nw_eval.twin.capture import Capture

Values = NDArray[np.float64]


def moved_points(T: Values, points: NDArray[np.floating]) -> Values:
    """Return points (N, 3) mapped by a similarity T (4, 4)."""
    return np.einsum("ij,nj->ni", T[:3, :3], points.astype(np.float64)) + T[:3, 3]


def moved_mesh(
    T: Values, vertices: NDArray[np.floating], faces: NDArray[np.integer], kind: FaceKind = "ground"
) -> TriangleMesh:
    """Return a mesh in metres, all its faces of one kind.

    Args:
        T: (4, 4) from capture to metres.
        vertices: (V, 3) in the capture's frame.
        faces: (F, 3), counter-clockwise from outside, as they stay.
        kind: of the faces.
    """
    return TriangleMesh(
        vertices=moved_points(T, vertices),
        faces=np.ascontiguousarray(faces, dtype=np.int32),
        kinds=np.full(len(faces), FACE_KINDS.index(kind), dtype=np.uint8),
    )


def moved_camera(T: Values, camera: Camera) -> Camera:
    """Return a camera in metres: its pose without scale, its near and far planes in metres.

    Raises:
        SceneError: T is no similarity.
    """
    scale = check_similarity(T, "an alignment")
    pose = T @ camera.T_world_camera
    unit = float(np.linalg.norm(pose[:3, 0]))
    pose[:3, :3] /= unit
    return replace(camera, T_world_camera=pose, near=camera.near * scale, far=camera.far * scale)


def moved_capture(T: Values, capture: Capture) -> Capture:
    """Return a capture in metres; its pictures are the same.

    Raises:
        SceneError: T is no similarity.
    """
    shots = tuple(replace(s, camera=moved_camera(T, s.camera)) for s in capture.shots)
    points = moved_points(T, capture.points)
    return replace(capture, shots=shots, points=points, metric=True, up=(0.0, 0.0, 1.0))


def similarity_entry(T: Values) -> dict[str, Any]:
    """Return what `T_world_splat` of a scene.yaml is to be: scale, quat (wxyz) and translation.

    Raises:
        SceneError: T is no similarity.
    """
    scale = check_similarity(T, "an alignment")
    quat = quaternions(T[:3, :3] / scale)
    quat = quat if quat[0] >= 0 else -quat
    return {"scale": scale, "quat": quat.tolist(), "translation": T[:3, 3].tolist()}
