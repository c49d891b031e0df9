"""Shots of a capture as photographs to train on: reduced, with depth where it is known."""

from __future__ import annotations

from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nw_eval.errors import SceneError, UsageError
from nw_eval.files.inside import inside
from nw_eval.files.pictures import open_picture
from nw_eval.twin.appearance.options import AppearanceOptions
from nw_eval.twin.capture import Capture, PlacedShot, read_picture
from nw_eval.twin.gaussians.photo import Photo
from nw_eval.twin.reconstruct import read_depth

_T = TypeVar("_T", bound=np.generic)
_DAMAGE = (OSError, ValueError, LookupError, TypeError, EOFError, SyntaxError)


def photos_of(
    capture: Capture, folder: Path, depths: Path | None, *, longest: int
) -> tuple[Photo, ...]:
    """Return a photograph of each shot, in the capture's frame.

    Args:
        capture: read from the folder.
        folder: of the capture, with its pictures.
        depths: folder of `<shot>.npz` with `depth` and `confidence`; None = nothing is known.
        longest: side that no picture exceeds, pixels.

    Raises:
        SceneError: a picture, mask or depth is missing or damaged.
    """
    return tuple(_photo(shot, folder, depths, longest) for shot in capture.shots)


def split_photos(
    photos: tuple[Photo, ...], options: AppearanceOptions
) -> tuple[tuple[Photo, ...], tuple[Photo, ...]]:
    """Return what is learnt from, and what is held out: by name, or every 8th as the field does it.

    Raises:
        UsageError: no photograph has such a name, or all have.
    """
    if options.held_out:
        held = tuple(photo for photo in photos if fnmatchcase(photo.name, options.held_out))
        if len(held) in {0, len(photos)}:
            raise UsageError(
                f"{options.held_out!r} holds out {len(held)} of {len(photos)} photographs",
                fix=f"name some of them, such as {photos[0].name}",
            )
        names = {photo.name for photo in held}
        return tuple(photo for photo in photos if photo.name not in names), held
    every = options.held_out_every
    if not every or len(photos) < 2 * every:
        return photos, ()
    held = photos[every // 2 :: every]
    return tuple(p for n, p in enumerate(photos) if n % every != every // 2), held


def _photo(shot: PlacedShot, folder: Path, depths: Path | None, longest: int) -> Photo:
    picture = read_picture(shot, folder)
    camera = shot.camera
    scale = min(1.0, longest / max(camera.width, camera.height))
    size = (round(camera.height * scale), round(camera.width * scale))
    down, right = size[0] / camera.height, size[1] / camera.width
    small = replace(
        camera,
        width=size[1],
        height=size[0],
        fx=camera.fx * right,
        cx=camera.cx * right,
        fy=camera.fy * down,
        cy=camera.cy * down,
    )
    if scale < 1.0:
        image = Image.fromarray(picture).resize((size[1], size[0]), Image.Resampling.BOX)
        picture = np.asarray(image)
    inverse, confidence = _depth(shot, depths, size)
    return Photo(
        name=shot.name,
        camera=small,
        rgb=np.ascontiguousarray(picture),
        inverse_depth=inverse,
        confidence=confidence,
        mask=_mask(shot, folder, size),
    )


def _mask(shot: PlacedShot, folder: Path, size: tuple[int, int]) -> NDArray[np.bool_] | None:
    if shot.mask is None:
        return None
    path = inside(folder, shot.mask)
    try:
        with open_picture(path) as image:
            return _nearest(np.asarray(image.convert("L")) > 0, size)
    except _DAMAGE as error:
        raise SceneError(f"{path} cannot be read: {error}", fix="calibrate again") from None


def _depth(
    shot: PlacedShot, depths: Path | None, size: tuple[int, int]
) -> tuple[NDArray[np.float32] | None, NDArray[np.float32] | None]:
    """Return inverse depth and confidence, 0 where nothing is known."""
    if depths is None:
        return None, None
    depth, confidence = (_nearest(array, size) for array in read_depth(depths, shot.name))
    return np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0.0), confidence


def _nearest(array: NDArray[_T], size: tuple[int, int]) -> NDArray[_T]:
    """Return an array (H, W) with another number of rows and columns: the nearest pixel's.

    Depth is not averaged: between two surfaces there is none.
    """
    if array.ndim != 2:
        raise ValueError(f"an array of shape {array.shape}")
    rows, columns = (
        ((np.arange(new) + 0.5) * old / new).astype(np.int64)
        for new, old in zip(size, array.shape, strict=True)
    )
    return np.ascontiguousarray(array[np.ix_(rows, columns)])
