"""A scene folder opened for labelling, and a labelling back into it: whole, or not at all.

Opening compiles no terrain. Its scene.yaml stays as a person wrote it, with what a labelling
decides changed in it and nothing else.

What is opened is a scene folder of one's own: the one that is named, or a copy of another place.
"""

from __future__ import annotations

import hashlib
import math
import re
import shutil
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from nw_base.errors import SceneError, StoreError, UsageError, nearest
from nw_base.files.cache import atomic_path, cache_dir, check_new, new_folder
from nw_base.files.inside import what_is
from nw_base.files.yaml_file import YamlProblems, read_yaml
from nw_eval.suite.load import robot_from, write_ready_suite
from nw_scenes.capture_file import CameraPose, read_poses, write_captures
from nw_scenes.folder import SCENE_FILE, folder_files, load_folder
from nw_scenes.limits import check_similarity
from nw_scenes.mesh import TriangleMesh, rotation_matrix
from nw_scenes.mesh_file import MESH_SUFFIXES, read_mesh
from nw_scenes.saving import (
    rounded,
    similarity_entry,
    write_collision,
    write_place,
)
from nw_sim.catalogue import brought, is_built_in, names, open_scene, scene_files
from nw_splat.gaussians import quaternions
from nw_twin.label.state import LabelState, Placement, StartPose, as_point, mapped
from nw_twin.place import SUITE, Route


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenedScene:
    """A scene folder as it was opened.

    Attributes:
        folder: that holds scene.yaml.
        name: of the scene.
        collision: the collision file's name in the folder.
        splat: of its looks; None = it has none.
        mesh: what can be touched; world, m.
        is_scan: whether the mesh is the collision file, not boxes: only then it can be moved.
        T_world_splat: (4, 4) similarity.
        captures: name of the file of the cameras that photographed it; None if unknown.
        cameras: those, in the order of the file; world.
        state: what scene.yaml says of the course.
    """

    folder: Path
    name: str
    collision: str
    splat: Path | None
    mesh: TriangleMesh
    is_scan: bool
    T_world_splat: NDArray[np.float64]
    captures: str | None
    cameras: tuple[CameraPose, ...]
    state: LabelState

    @property
    def walk(self) -> NDArray[np.float64]:
        """Where the cameras stood, (N, 3), m, in order."""
        return np.array([position for position, _ in self.cameras], dtype=float).reshape(-1, 3)


def open_place(folder: Path) -> OpenedScene:
    """Read a scene folder.

    Raises:
        SceneError: a file is missing or wrong; every problem with file and line.
    """
    files = folder_files(folder)  # Checks all of scene.yaml.
    try:
        text = read_yaml(folder / SCENE_FILE).data
    except YamlProblems as error:  # It was changed just now.
        raise SceneError(error.problems) from None
    collision = str(text.get("collision", "collision.yaml"))
    splat, captures = text.get("splat"), text.get("captures")
    is_scan = files[collision].suffix.lower() in MESH_SUFFIXES
    spawn = text.get("spawn", {})
    return OpenedScene(
        folder=folder,
        name=str(text["name"]),
        collision=collision,
        splat=files[splat] if splat is not None else None,
        mesh=read_mesh(files[collision])
        if is_scan
        else load_folder(folder, needs_scale=False).static_mesh,
        is_scan=is_scan,
        T_world_splat=Placement(**text.get("T_world_splat", {})).matrix,
        captures=captures,
        cameras=read_poses(files[captures]) if captures is not None else (),
        state=LabelState(
            to_scale=text.get("units", "m") == "m",
            task=text["task"],
            waypoints=tuple(as_point(np.array(point, dtype=float)) for point in text["trail"]),
            start=StartPose(
                position=as_point(np.array(spawn.get("position", (0.0, 0.0, 0.0)), dtype=float)),
                yaw=float(spawn.get("yaw", 0.0)),
            ),
        ),
    )


_OURS = re.compile(r"collision-[0-9a-f]{12}\.ply|captures-[0-9a-f]{12}\.json")
"""Moved or cropped meshes, and moved cameras. Those that a build wrote stay as they are: a crop can
be taken back."""


def _clear(folder: Path) -> None:
    """Remove what a process has left that was killed as it saved."""
    for left in folder.glob(".label-*"):
        shutil.rmtree(left, ignore_errors=True)


def save_label(
    place: OpenedScene,
    *,
    course: Route,
    mesh: TriangleMesh | None,
    T_world_opened: NDArray[np.float64],
    to_scale: bool = True,
) -> None:
    """Rewrite scene.yaml of a folder; its other keys and its comments stay where they can.

    The new scene is loaded from beside before anything is changed, and scene.yaml, which names the
    mesh and the cameras that belong to it, is replaced last.

    Args:
        place: as it was opened; its folder is written.
        course: task, course and start.
        mesh: what can be touched now, world, m; None = it is still the one that was opened.
        T_world_opened: (4, 4) similarity by which splat and cameras are moved.
        to_scale: whether all that is in metres now.

    Raises:
        SceneError: scene.yaml is wrong, or what would be saved cannot be loaded.
        StoreError: it cannot be written.
    """
    folder = place.folder
    files = folder_files(folder)
    text = SceneText(folder / SCENE_FILE)
    _clear(folder)
    try:
        with TemporaryDirectory(dir=folder, prefix=".label-") as name, ExitStack() as moves:
            staged = Path(name)
            collision, captures = place.collision, place.captures
            if mesh is not None:
                collision = _write_mesh(staged, mesh)
            else:
                _copy(collision, folder, staged)
            if captures is not None and not np.array_equal(T_world_opened, np.eye(4)):
                captures = _write_cameras(staged, place, T_world_opened)
            elif captures is not None:
                _copy(captures, folder, staged)
            written = text.edit(
                course,
                collision=collision,
                captures=captures,
                T_world_splat=T_world_opened @ place.T_world_splat,
                to_scale=to_scale,
            )
            (staged / SCENE_FILE).write_text(written, encoding="utf-8")
            splat = text.splat
            if splat is not None and what_is(files[splat]) == "file":
                # It is large, and loading a scene only looks whether it is there.
                (staged / splat).parent.mkdir(parents=True, exist_ok=True)
                (staged / splat).touch()
            load_folder(staged, needs_scale=False)
            for old, new in ((place.collision, collision), (place.captures, captures)):
                if new is not None and new != old:
                    moves.enter_context(_moved_in(staged / new, folder / new))
            temporary = moves.enter_context(atomic_path(folder / SCENE_FILE))
            temporary.write_text(written, encoding="utf-8")
    except OSError as error:
        raise StoreError(
            f"cannot write {folder}: {error.strerror or error}",
            fix="free disk space, or allow writing there",
        ) from error
    needed = {collision, captures, place.collision, place.captures}
    for path in folder.iterdir():
        if _OURS.fullmatch(path.name) and path.name not in needed:
            with suppress(OSError):
                path.unlink()


def _copy(name: str, folder: Path, staged: Path) -> None:
    (staged / name).parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(folder / name, staged / name)


@contextmanager
def _moved_in(staged: Path, path: Path) -> Generator[None]:
    """Move a file to its place, and away again if what follows fails; not if it was there."""
    is_new = what_is(path) == "nothing"
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
        raise SceneError("the crop leaves nothing of the scene", fix="make the crop larger")
    path = staged / "mesh.ply"
    write_collision(path, mesh.vertices, mesh.faces)
    return _named_by_content(path, "collision")


def _write_cameras(staged: Path, place: OpenedScene, T: NDArray[np.float64]) -> str:
    rotation = T[:3, :3] / check_similarity(T, "the scene")
    path = staged / "cameras.json"
    moved = [
        (mapped(np.array([position]), T)[0], quaternions(rotation @ rotation_matrix(quat)))
        for position, quat in place.cameras
    ]
    write_captures(path, [(at.tolist(), quat.tolist()) for at, quat in moved])
    return _named_by_content(path, "captures")


def _named_by_content(path: Path, word: str) -> str:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return path.replace(path.with_name(f"{word}-{digest[:12]}{path.suffix}")).name


class SceneText:
    """The content of a scene.yaml, checked already, its comments and spelling with it.

    Args:
        path: of the file.

    Raises:
        SceneError: it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._yaml, self._text = _round_trip(path)

    @property
    def splat(self) -> str | None:
        """The name of the splat's file; None = it has none."""
        return self._text.get("splat")

    def edit(
        self,
        course: Route,
        *,
        collision: str,
        captures: str | None,
        T_world_splat: NDArray[np.float64],
        to_scale: bool = True,
    ) -> str:
        """Return the text with the values of a labelling; unchanged values keep their spelling."""
        if "units" in self._text or not to_scale:
            _put(self._text, "units", "m" if to_scale else "unknown")
        _edit(self._text, course, collision, captures, T_world_splat)
        stream = StringIO()
        self._yaml.dump(self._text, stream)
        return stream.getvalue()


def _edit(
    text: CommentedMap,
    course: Route,
    collision: str,
    captures: str | None,
    T_world_splat: NDArray[np.float64],
) -> None:
    _put(text, "task", course.task)
    _put_trail(text, [rounded(point) for point in course.trail])
    spawn = text.setdefault("spawn", CommentedMap())
    _put(spawn, "position", rounded(course.spawn))
    yaw = math.remainder(course.yaw, 2 * math.pi)
    _put(spawn, "yaw", round(yaw, 4))
    if text.get("collision", "collision.yaml") != collision:
        text["collision"] = collision
    if captures is not None:
        _put(text, "captures", captures)
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
    """Return the content of a file, and a function that writes it in the same format."""
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
    folder = brought(reference)
    files = None if is_built_in(folder) else scene_files(folder)
    with new_folder(out) as staged:
        if files is None or files.prefix:
            write_place(open_scene(folder), staged)
        else:
            for name, path in files.files.items():
                (staged / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, staged / name)
        name, own = load_folder(staged, needs_scale=False).name, robot_from(out, robot)
        write_ready_suite(staged / SUITE, name, ["."], robot=own)
