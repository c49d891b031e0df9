"""A labelling back into its scene folder: whole, or not at all."""

from __future__ import annotations

import hashlib
import math
import re
import shutil
from collections.abc import Generator
from contextlib import contextmanager, suppress
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from nw_eval.errors import SceneError, StoreError
from nw_eval.files.cache import atomic_path
from nw_eval.files.inside import what_is
from nw_eval.scenes.folder import SCENE_FILE, folder_files, load_folder
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.twin.align.apply import similarity_entry
from nw_eval.twin.label.placement import Placement
from nw_eval.twin.place.entries import rounded, write_collision
from nw_eval.twin.place.write import Route

_OURS = re.compile(r"collision-[0-9a-f]{12}\.ply")
"""Moved or cropped meshes. The one that a build wrote stays as it is: a crop can be taken back."""


def save_label(
    folder: Path,
    *,
    course: Route,
    opened_collision: str,
    mesh: TriangleMesh | None,
    T_world_splat: NDArray[np.float64],
) -> None:
    """Rewrite scene.yaml of a folder; its other keys and its comments stay where they can.

    The new scene is loaded from beside before anything is changed, and scene.yaml, which names the
    mesh that belongs to it, is replaced last.

    Args:
        folder: with a scene.yaml.
        course: task, trail and start.
        opened_collision: name of the collision file that the labelling began with.
        mesh: what can be touched now, world, m; None = it is still `opened_collision`.
        T_world_splat: (4, 4) similarity; not looked at where it has no splat.

    Raises:
        SceneError: scene.yaml is wrong, or what would be saved cannot be loaded.
        StoreError: it cannot be written.
    """
    files = folder_files(folder)
    yaml, text = _round_trip(folder / SCENE_FILE)
    try:
        with TemporaryDirectory(dir=folder, prefix=".label-") as name:
            staged = Path(name)
            collision = opened_collision
            if mesh is not None:
                collision = _write_mesh(staged, mesh)
            else:
                (staged / collision).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(folder / collision, staged / collision)
            _edit(text, course, collision, T_world_splat)
            written = _dumped(yaml, text)
            (staged / SCENE_FILE).write_text(written, encoding="utf-8")
            splat = text.get("splat")
            if splat is not None and what_is(files[splat]) == "file":
                # It is large, and loading a scene only looks whether it is there.
                (staged / splat).parent.mkdir(parents=True, exist_ok=True)
                (staged / splat).touch()
            load_folder(staged)
            with (
                _moved_in(staged / collision, folder / collision, is_new=mesh is not None),
                atomic_path(folder / SCENE_FILE) as temporary,
            ):
                temporary.write_text(written, encoding="utf-8")
    except OSError as error:
        raise StoreError(
            f"cannot write {folder}: {error.strerror or error}",
            fix="free disk space, or allow writing there",
        ) from error
    for path in folder.iterdir():
        if _OURS.fullmatch(path.name) and path.name not in {collision, opened_collision}:
            with suppress(OSError):
                path.unlink()


@contextmanager
def _moved_in(staged: Path, path: Path, *, is_new: bool) -> Generator[None]:
    """Move a file to its place, and away again if what follows fails; not if it was there."""
    is_new = is_new and what_is(path) == "nothing"
    if is_new:
        staged.replace(path)
    try:
        yield
    except BaseException:
        if is_new:
            path.unlink(missing_ok=True)
        raise


def _write_mesh(staged: Path, mesh: TriangleMesh) -> str:
    if len(mesh.faces) == 0:
        raise SceneError("the crop leaves nothing of the place", fix="make the crop larger")
    path = staged / "mesh.ply"
    write_collision(path, mesh.vertices, mesh.faces)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    name = f"collision-{digest[:12]}.ply"
    path.replace(staged / name)
    return name


def _edit(
    text: CommentedMap,
    course: Route,
    collision: str,
    T_world_splat: NDArray[np.float64],
) -> None:
    """Change what a labelling decides; what is as it was keeps its very spelling."""
    _put(text, "task", course.task)
    _put_trail(text, [rounded(point) for point in course.trail])
    spawn = text.setdefault("spawn", CommentedMap())
    _put(spawn, "position", rounded(course.spawn))
    yaw = math.remainder(course.yaw, 2 * math.pi)
    _put(spawn, "yaw", round(yaw, 4))
    if text.get("collision", "collision.yaml") != collision:
        text["collision"] = collision
    if text.get("splat") is not None:
        entry = text.setdefault("T_world_splat", CommentedMap())
        if not np.allclose(Placement(**entry).matrix, T_world_splat, rtol=0.0, atol=1e-12):
            for name, value in similarity_entry(T_world_splat).items():
                _put(entry, name, value)


def _put(mapping: CommentedMap, name: str, value: Any) -> None:
    if name in mapping and _plain(mapping[name]) == _plain(value):
        return
    mapping[name] = _flow(value) if isinstance(value, list) else value


def _put_trail(text: CommentedMap, trail: list[list[float]]) -> None:
    """Replace points in place, so that comments between them stay."""
    points: Any = text["trail"]
    for i, point in enumerate(trail):
        if i >= len(points):
            points.append(_flow(point))
        elif _plain(points[i]) != point:
            comments = getattr(points[i], "ca", None)
            points[i] = _flow(point)
            if comments is not None:
                points[i].ca.comment = comments.comment
                points[i].ca.end = comments.end
    while len(points) > len(trail):
        points.pop()


def _plain(value: Any) -> Any:
    return [float(part) for part in value] if isinstance(value, list) else value


def _flow(values: list[float]) -> CommentedSeq:
    sequence = CommentedSeq(values)
    sequence.fa.set_flow_style()
    return sequence


def _round_trip(path: Path) -> tuple[YAML, CommentedMap]:
    """Return the content of a file, and what writes it in the same manner."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror or error}") from None
    yaml = YAML()  # The round trip's; folder_files has refused tags, and it runs none anyway.
    yaml.preserve_quotes = True
    yaml.width = 100
    if (item := re.search(r"^trail:.*\n(?: *#.*\n)*( +)- ", text, re.MULTILINE)) is not None:
        offset = len(item[1])
        yaml.indent(mapping=2, sequence=offset + 2, offset=offset)
    return yaml, yaml.load(text)


def _dumped(yaml: YAML, text: CommentedMap) -> str:
    stream = StringIO()
    yaml.dump(text, stream)
    return stream.getvalue()
