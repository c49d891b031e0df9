"""What lies at a path: the most particular kind that it can be."""

from __future__ import annotations

from pathlib import Path
from zipfile import is_zipfile

from nw_eval.errors import SceneError
from nw_eval.files.inside import what_is
from nw_eval.files.pictures import open_picture
from nw_eval.twin.calibrate.colmap import colmap_in
from nw_eval.twin.calibrate.exports import (
    arkit_scenes_in,
    keyframes_in,
    nerfstudio_in,
    record3d_in,
)
from nw_eval.twin.calibrate.footage import Footage, photographs_in
from nw_eval.twin.calibrate.pace import Say
from nw_eval.twin.calibrate.photographs import DAMAGE
from nw_eval.twin.calibrate.video import VIDEOS, frames_of

_FIX = (
    "give a folder of photographs, a video, or a folder of COLMAP, nerfstudio (transforms.json), "
    "Polycam (keyframes/), Record3D (metadata), 3D Scanner App (frame_*.json) or ARKitScenes"
)


def find_source(
    path: Path, working: Path, *, frames: int, say: Say, per_second: float | None = None
) -> Footage:
    """Return what lies at a path.

    Args:
        path: of a folder, a video or a transforms.json.
        working: folder that frames of a video are written to.
        frames: taken of a video, at most.
        say: is given lines of progress.
        per_second: frames taken of a second of video; None = as the picture moves.

    Raises:
        SceneError: there is nothing that can be read, or it is damaged.
        PrerequisiteError: a package is missing.
    """
    kind = what_is(path)
    if kind == "nothing":
        raise SceneError(f"{path} is not there", fix=_FIX)
    if kind == "folder":
        source = _in_folder(path, working, frames, say)
        if source is not None:
            return source
        films = [one for one in path.iterdir() if one.suffix.lower() in VIDEOS]
        if len(films) != 1 or what_is(films[0]) != "file":
            if len(films) > 1:
                raise SceneError(f"{path} holds {len(films)} videos", fix="give one of them")
            raise SceneError(f"nothing in {path} is a photograph", fix=_FIX)
        path = films[0]
    elif path.name.startswith("transforms") and path.suffix == ".json":
        source = nerfstudio_in(path.parent, _size, path.name)
        if source is not None:
            return source
    elif path.suffix.lower() not in VIDEOS:
        if is_zipfile(path):
            raise SceneError(
                f"{path} is a zip archive, as Record3D's .r3d and other exports are",
                fix="unpack it, and give the folder",
            )
        raise SceneError(f"{path} is no video", fix=_FIX)
    return frames_of(path, working, frames, say, per_second=per_second)


def _in_folder(path: Path, working: Path, frames: int, say: Say) -> Footage | None:
    return (
        nerfstudio_in(path, _size)
        or keyframes_in(path, working, _size)
        or record3d_in(path, frames, say)
        or arkit_scenes_in(path, frames, say)
        or colmap_in(path, say)
        or photographs_in(path)
    )


def _size(path: Path) -> tuple[int, int] | None:
    try:
        with open_picture(path) as image:
            return image.size
    except DAMAGE:
        return None
