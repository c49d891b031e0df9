"""Folders of COLMAP: a model, and the photographs that it was made of."""

from __future__ import annotations

from pathlib import Path

from nw_eval.errors import SceneError
from nw_eval.twin.calibrate.pace import Say
from nw_eval.twin.calibrate.sources.colmap_files import has_model, image_count, read_model
from nw_eval.twin.calibrate.sources.folder import with_masks
from nw_eval.twin.calibrate.sources.footage import Footage, found_in, in_order

_PLACES = ("sparse", "colmap/sparse", "dense/sparse", ".")


def colmap_in(folder: Path, say: Say) -> Footage | None:
    """Return the cameras and photographs of a COLMAP folder; None if it is none.

    Its model lies in `sparse/0`, `sparse` or the folder itself; of several in `sparse`, the one of
    the most photographs is taken. Its photographs lie in `images`, or beside the model.

    Args:
        folder: that may be one.
        say: is told which of several models is taken.

    Raises:
        SceneError: the model is damaged, or holds no photograph.
    """
    place = next((found for name in _PLACES if (found := _model(folder / name, say))), None)
    if place is None:
        return None
    cameras = read_model(place)
    if not cameras.placed:
        raise SceneError(f"the COLMAP model in {place} holds no photograph", fix="map again")
    beside = [folder / "images", place / "images", folder]
    is_several = place.parent == folder and place.name.isdecimal()
    if place == folder or is_several:  # The path of a model itself, or of several.
        beside += [folder.parent / "images", folder.parent.parent / "images", folder.parent]
    names = [one.name for one in cameras.placed]
    # Names may begin with `images/`: where the most are found is what they are relative to.
    images = max((one for one in beside if one.is_dir()), key=lambda one: _there(one, names))
    files = [found_in(images, name.replace("\\", "/"), called=name) for name in names]
    files = with_masks(files, [images / "masks", images.parent / "masks"])
    return Footage(kind="colmap", files=in_order(files), cameras=cameras)


def _model(folder: Path, say: Say) -> Path | None:
    """Return where the model of a folder lies: in one of its numbered folders, or itself."""
    if not folder.is_dir():
        return None
    numbered = sorted(
        (one for one in folder.iterdir() if one.name.isdecimal() and has_model(one)),
        key=lambda one: int(one.name),
    )
    if not numbered:
        return folder if has_model(folder) else None
    counts = [image_count(one) for one in numbered]
    most = max(counts)
    best = numbered[counts.index(most)]
    if len(numbered) > 1:
        others = ", ".join(
            f"{one.name} has {count}" for one, count in zip(numbered, counts, strict=True)
        )
        say(
            f"{len(numbered)} models in {folder}: {best.name} is taken, which has the most "
            f"photographs ({others}); give {folder}/N for another"
        )
    return best


def _there(folder: Path, names: list[str]) -> int:
    files = (found_in(folder, name.replace("\\", "/")).path for name in names)
    return sum(1 for path in files if path is not None and path.is_file())
