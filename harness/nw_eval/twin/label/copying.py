"""A scene folder of one's own, to label: the one that is named, or a copy of any other place."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from nw_eval.catalogue import brought, is_built_in, names, open_scene, scene_files
from nw_eval.errors import SceneError, UsageError, nearest
from nw_eval.files.cache import cache_dir, check_new, new_folder
from nw_eval.files.inside import what_is
from nw_eval.scenes.folder import SCENE_FILE, FileSplat, load_folder
from nw_eval.scenes.limits import name_of
from nw_eval.scenes.scene import Box, Scene
from nw_eval.splat.files import read_splat, write_splat
from nw_eval.suite.load import robot_from, write_ready_suite
from nw_eval.twin.moved import similarity_entry
from nw_eval.twin.place import COLLISION, SPLAT, SUITE, rounded, write_collision, write_yaml

_BOXES = "collision.yaml"


def own_folder(reference: str, out: Path | None, *, robot: str = "go1") -> Path:
    """Return the scene folder to label, copied first where `out` says so.

    Args:
        reference: a scene folder, or with `out` any place that a suite can name.
        out: folder of the copy, which must not be there; None = the scene is labelled where it is.
        robot: of the copy's suite.

    Raises:
        UsageError: the scene cannot be edited and there is no `out`, or `out` is in use.
        SceneError: there is no such scene, or it cannot be read.
        FetchError, PrerequisiteError: it is on a hub, and cannot be fetched.
        StoreError: the copy cannot be written.
    """
    if out is not None:
        copy_scene(reference, out, robot=robot)
        return out
    path = Path(reference)
    folder = path.parent if path.name == SCENE_FILE else path
    if is_built_in(reference):
        what = "a built-in scene, generated from data"
    elif reference.startswith(("hub:", "neverwhere:", "real:")):
        what = "not a scene folder of your own"
    elif what_is(folder) != "folder":
        raise SceneError(
            f"no built-in scene and no folder is called {reference!r}",
            fix=nearest(reference, names()),
        )
    elif folder.resolve().is_relative_to(cache_dir().resolve()):
        what = "in the cache, where runs expect it as it was fetched"
    else:
        return folder
    raise UsageError(
        f"{reference} is {what}: it cannot be edited itself",
        fix=f"label a copy: nw-eval twin label {reference} --out my-scene",
    )


def copy_scene(reference: str, out: Path, *, robot: str = "go1") -> None:
    """Write a scene folder of any place, with a suite that runs it; whole or not at all.

    A folder's files are copied. Of built-in and published scenes the boxes are written, or the mesh
    where there are other solids; Gaussians as they are. Such a copy is called as its folder is.

    Raises:
        UsageError: something is at `out` already.
        SceneError, FetchError, PrerequisiteError: as `own_folder`.
        StoreError: it cannot be written.
    """
    check_new(out, fix=f"label that, nw-eval twin label {out}, or name another")
    here = brought(reference)
    files = None if is_built_in(here) else scene_files(here)
    with new_folder(out) as staged:
        if files is None or files.prefix:
            write_place(open_scene(here), staged)
        else:
            for name, path in files.files.items():
                (staged / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, staged / name)
        name, own = load_folder(staged, needs_scale=False).name, robot_from(out, robot)
        write_ready_suite(staged / SUITE, name, ["."], robot=own)


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
