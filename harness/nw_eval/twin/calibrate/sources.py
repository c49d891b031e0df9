"""What lies at a path: the most particular kind that it can be."""

from __future__ import annotations

from pathlib import Path

from nw_eval.errors import SceneError
from nw_eval.files.inside import what_is
from nw_eval.files.pictures import open_picture
from nw_eval.twin.calibrate.colmap import colmap_in
from nw_eval.twin.calibrate.exports import FILE, nerfstudio_in, polycam_in
from nw_eval.twin.calibrate.footage import Footage, photographs_in
from nw_eval.twin.calibrate.pace import Say
from nw_eval.twin.calibrate.photographs import DAMAGE
from nw_eval.twin.calibrate.video import VIDEOS, frames_of

_FIX = (
    "give a folder of photographs, a video, or a folder of COLMAP, nerfstudio (transforms.json) "
    "or Polycam (keyframes/)"
)


def find_source(path: Path, working: Path, *, frames: int, say: Say) -> Footage:
    """Return what lies at a path.

    Args:
        path: of a folder, a video or a transforms.json.
        working: folder that frames of a video are written to.
        frames: taken of a video, at most.
        say: is given lines of progress.

    Raises:
        SceneError: there is nothing that can be read, or it is damaged.
        PrerequisiteError: a package is missing.
    """
    kind = what_is(path)
    if kind == "nothing":
        raise SceneError(f"{path} is not there", fix=_FIX)
    if kind == "file":
        if path.suffix.lower() in VIDEOS:
            return frames_of(path, working, frames, say)
        if path.name != FILE:
            raise SceneError(f"{path} is no video", fix=_FIX)
        path = path.parent
    source = (
        nerfstudio_in(path, _size)
        or polycam_in(path)
        or colmap_in(path, say)
        or photographs_in(path)
    )
    if source is not None:
        return source
    videos = [one for one in sorted(path.iterdir()) if one.suffix.lower() in VIDEOS]
    if len(videos) == 1 and what_is(videos[0]) == "file":
        return frames_of(videos[0], working, frames, say)
    if (path / "transforms_train.json").is_file():
        raise SceneError(
            f"{path} has cameras in transforms_train.json, and no {FILE}",
            fix=f"copy that file to {FILE}",
        )
    raise SceneError(f"nothing in {path} is a photograph", fix=_FIX)


def _size(path: Path) -> tuple[int, int] | None:
    try:
        with open_picture(path) as image:
            return image.size
    except DAMAGE:
        return None
