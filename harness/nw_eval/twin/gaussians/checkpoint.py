"""A training on disk, to go on with later, with the bits that it would have had without a break."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.arrays import pack, unpack
from nw_eval.errors import NwEvalError, StoreError
from nw_eval.files.cache import DamagedError, read_sealed, sealed_path
from nw_eval.splat.gaussians import ARRAYS, Gaussians
from nw_eval.splat.store import digest
from nw_eval.twin.gaussians.config import TrainConfig
from nw_eval.twin.gaussians.photo import Photo
from nw_eval.twin.gaussians.population import Population
from nw_eval.twin.gaussians.trainer import Trainer

FORMAT = 2
"""Changes with the arrays of a checkpoint, and with what a step does to them."""

_PARTS = ("values", "mean", "square")
_EXPOSURES = ("maps", "mean", "square", "steps")


def save_training(path: Path, trainer: Trainer) -> None:
    """Write a training's state; a reader sees the old file or the new one whole.

    Raises:
        StoreError: the file cannot be written.
    """
    population = trainer.population
    parts = zip(_PARTS, (population.gaussians, *population.moments), strict=True)
    arrays: dict[str, NDArray[Any]] = {
        f"{part}.{name}": getattr(gaussians, name) for part, gaussians in parts for name in ARRAYS
    }
    arrays |= {f"exposure.{name}": getattr(trainer.exposures, name) for name in _EXPOSURES}
    arrays |= {f"density.{name}": array for name, array in trainer.density.arrays().items()}
    arrays["iteration"] = np.array(trainer.iteration, dtype=np.int64)
    arrays["about"] = np.frombuffer(
        _about(trainer.photos, trainer.began, trainer.config), dtype=np.uint8
    )
    with sealed_path(path) as temporary:
        temporary.write_bytes(pack(arrays))


def resume_training(
    path: Path,
    photos: Sequence[Photo],
    start: Gaussians,
    config: TrainConfig,
    *,
    threads: int = 1,
) -> Trainer:
    """Return a training as it was saved.

    Args:
        path: of `save_training`.
        photos: as before.
        start: as before: what it began with, not what it has come to.
        config: as before.
        threads: any number.

    Raises:
        StoreError: there is none, it is damaged, or it is of other photographs, began with other
            Gaussians, or was asked for other things.
    """
    try:
        arrays = unpack(bytes(read_sealed(path)))
    except (OSError, DamagedError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise StoreError(
            f"{path}: no training to go on with: {reason}", fix="begin it anew"
        ) from error
    about, began = arrays.pop("about", np.zeros(0, dtype=np.uint8)).tobytes(), digest(start)
    if about != _about(photos, began, config):
        raise StoreError(
            f"{path}: a training of other photographs or another mesh, or asked for other things",
            fix="go on with what it began with, or begin anew",
        )
    try:
        trainer = _restored(arrays, photos, config, threads)
    except (KeyError, ValueError, NwEvalError) as error:
        raise StoreError(
            f"{path}: arrays of a training are missing or do not belong together: {error}",
            fix="begin it anew",
        ) from error
    trainer.began = began
    return trainer


def _restored(
    arrays: dict[str, NDArray[Any]], photos: Sequence[Photo], config: TrainConfig, threads: int
) -> Trainer:
    values, mean, square = (
        Gaussians(**{name: arrays[f"{part}.{name}"] for name in ARRAYS}, rasterize_mode=None)
        for part in _PARTS
    )
    trainer = Trainer(photos, values, config, threads=threads)
    for part in (mean, square):
        for name in ARRAYS:
            _check(getattr(part, name), getattr(values, name))
    trainer.population = Population(values, (mean, square))
    for owner, names, kind in (
        (trainer.exposures, _EXPOSURES, "exposure"),
        (trainer.density, trainer.density.remembered, "density"),
    ):
        for name in names:
            array = arrays[f"{kind}.{name}"]
            _check(array, getattr(owner, name))
            setattr(owner, name, array)
    iteration = arrays["iteration"]
    _check(iteration, np.array(0, dtype=np.int64))
    if not 0 <= iteration <= config.iterations:
        raise ValueError(f"{iteration} steps of {config.iterations}")
    trainer.iteration = int(iteration)
    return trainer


def _check(array: NDArray[Any], like: NDArray[Any]) -> None:
    if array.shape != like.shape or array.dtype != like.dtype:
        raise ValueError(f"{array.dtype} {array.shape} instead of {like.dtype} {like.shape}")


def _about(photos: Sequence[Photo], began: str, config: TrainConfig) -> bytes:
    """Return what a training is of: its config, its photographs, and what it began with."""
    shown = [(photo.name, photo.digest()) for photo in photos]
    of = {"format": FORMAT, "photos": shown, "began": began, "config": asdict(config)}
    return json.dumps(of).encode()
