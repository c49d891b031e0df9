"""Folders of COLMAP: a model, and the photographs that it was made of."""

from __future__ import annotations

from pathlib import Path

from nw_eval.errors import SceneError
from nw_eval.twin.calibrate.sources.colmap_files import has_model, read_model
from nw_eval.twin.calibrate.sources.folder import with_masks
from nw_eval.twin.calibrate.sources.footage import Footage, found_in, in_order

_MODELS = ("sparse/0", "sparse", "colmap/sparse/0", "dense/sparse", ".")


def colmap_in(folder: Path) -> Footage | None:
    """Return the cameras and photographs of a COLMAP folder; None if it is none.

    Its model lies in `sparse/0`, `sparse` or the folder itself; its photographs in `images`, or
    beside the model.

    Raises:
        SceneError: the model is damaged, or holds no photograph.
    """
    place = next((folder / name for name in _MODELS if has_model(folder / name)), None)
    if place is None:
        return None
    cameras = read_model(place)
    if not cameras.placed:
        raise SceneError(f"the COLMAP model in {place} holds no photograph", fix="map again")
    beside = [folder / "images", place / "images", folder]
    if place == folder:  # The path of a model itself: its project is a folder or two up.
        beside[2:2] = [folder.parent / "images", folder.parent.parent / "images"]
    images = next((one for one in beside if one.is_dir()), folder)
    files = [found_in(images, one.name) for one in cameras.placed]
    files = with_masks(files, [images / "masks", images.parent / "masks"])
    return Footage(kind="colmap", files=in_order(files), cameras=cameras)
