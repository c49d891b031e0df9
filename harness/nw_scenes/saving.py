"""Writing a scene folder: what `folder` reads.

Points stand on one line each; every file is written whole or not at all.
"""

from __future__ import annotations

from collections.abc import Iterable
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML

from nw_base.files.cache import atomic_path
from nw_scenes.folder import SCENE_FILE, FileSplat
from nw_scenes.limits import check_similarity, name_of
from nw_scenes.scene import Box, Scene
from nw_splat.files import read_splat, write_splat
from nw_splat.gaussians import quaternions

COLLISION = "collision.ply"
SPLAT = "splat.ply"
_BOXES = "collision.yaml"


def write_yaml(path: Path, text: dict[str, Any]) -> None:
    """Write a mapping as YAML, each point on one line, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    stream = StringIO()
    yaml.dump(text, stream)
    with atomic_path(path) as temporary:
        temporary.write_text(stream.getvalue(), encoding="utf-8")


def rounded(point: Iterable[float]) -> list[float]:
    """Return metres, to a tenth of a millimetre."""
    return [round(float(part), 4) for part in point]


def write_collision(
    path: Path, vertices: NDArray[np.float64], faces: NDArray[np.integer[Any]]
) -> None:
    """Write vertices (V, 3), world, m, and faces (F, 3) as a PLY file, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    import trimesh

    mesh = trimesh.Trimesh(vertices=vertices, faces=faces, process=False)
    with atomic_path(path) as temporary:
        mesh.export(temporary, file_type="ply")


def similarity_entry(T: NDArray[np.float64]) -> dict[str, Any]:
    """Return what `T_world_splat` of a scene.yaml is to be: scale, quat (wxyz) and translation.

    Raises:
        SceneError: T is no similarity.
    """
    scale = check_similarity(T, "an alignment")
    quat = quaternions(T[:3, :3] / scale)
    quat = quat if quat[0] >= 0 else -quat
    return {"scale": scale, "quat": quat.tolist(), "translation": T[:3, 3].tolist()}


def write_place(scene: Scene, folder: Path) -> None:
    """Write the files of a scene folder: Gaussians, and boxes or the mesh where not all are boxes.

    Raises:
        OSError, StoreError: they cannot be written.
    """
    boxes = [solid for solid in scene.solids if isinstance(solid, Box)]
    is_boxes = len(boxes) == len(scene.solids)
    if is_boxes:
        write_yaml(folder / _BOXES, {"boxes": [_box(box) for box in boxes]})
    else:
        write_collision(folder / COLLISION, scene.static_mesh.vertices, scene.static_mesh.faces)
    spawn = scene.spawn
    text: dict[str, Any] = {
        "nw-scene": 1,
        "name": name_of(folder.name),
        "title": scene.title,
        "task": scene.task,
        "licence": scene.licence,
        "collision": _BOXES if is_boxes else COLLISION,
        "ground": scene.ground.z,
        "trail": [rounded(point) for point in scene.trail],
        "spawn": {
            "position": rounded(spawn.position),
            "yaw": spawn.yaw,
            "x_jitter": spawn.x_jitter,
            "y_jitter": spawn.y_jitter,
            "yaw_jitter": spawn.yaw_jitter,
        },
        "waypoint_noise": list(scene.waypoint_noise),
    }
    if scene.splat is not None:
        source = scene.splat.path if isinstance(scene.splat, FileSplat) else scene.splat_store()
        write_splat(folder / SPLAT, read_splat(source))
        text |= {"splat": SPLAT, "T_world_splat": similarity_entry(scene.T_world_splat)}
    write_yaml(folder / SCENE_FILE, text)


def _box(box: Box) -> dict[str, Any]:
    kind = box.kind if box.kind in {"obstacle", "structure", "clutter"} else "structure"
    return {
        "center": [*map(float, box.center)],
        "half_size": [*map(float, box.half_size)],
        "quat": [*map(float, box.quat)],
        "friction": [*map(float, box.friction)],
        "material": box.material,
        "kind": kind,
    }
