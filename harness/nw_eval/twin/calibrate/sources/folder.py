"""A folder of photographs, with masks beside them or not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from nw_eval.errors import SceneError
from nw_eval.files.inside import OutsideError, inside
from nw_eval.twin.calibrate.photographs import SUFFIXES, Found
from nw_eval.twin.calibrate.sources.footage import Footage, found_in, in_order


def photographs_in(folder: Path) -> Footage | None:
    """Return the photographs of a folder, or of `images` in it; None if there are none."""
    for place, beside in ((folder, ()), (folder / "images", (folder,))):
        names = _names(place, SUFFIXES)
        if names:
            files = [found_in(place, name) for name in names]
            files = with_masks(files, [place / "masks", *(b / "masks" for b in beside)])
            return Footage(kind="photographs", files=in_order(files))
    return None


def _names(folder: Path, suffixes: frozenset[str]) -> list[str]:
    if not folder.is_dir():
        return []
    return [
        path.name
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and not path.name.startswith(".") and not path.is_dir()
    ]


def with_masks(files: list[Found], folders: list[Path]) -> list[Found]:
    """Return photographs with their masks: `IMG_1.jpg.png` or `IMG_1.png` for `IMG_1.jpg`.

    Raises:
        SceneError: a mask is a link that leads out of its folder.
    """
    folder = next((place for place in folders if place.is_dir()), None)
    if folder is None:
        return files
    masks = {name.lower(): name for name in sorted(_names(folder, SUFFIXES))}
    stems = {Path(name).stem.lower(): name for name in sorted(_names(folder, SUFFIXES))}
    found: list[Found] = []
    for one in files:
        name = one.name.lower()
        mask = masks.get(f"{name}.png") or stems.get(Path(name).stem)
        try:
            found.append(one if mask is None else replace(one, mask=inside(folder, mask)))
        except OutsideError as error:
            raise SceneError(
                f"the mask {mask} is not in {folder}: {error}", fix="copy it there"
            ) from None
    return found
