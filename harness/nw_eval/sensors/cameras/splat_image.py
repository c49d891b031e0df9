"""From rendered floats to the array that a checkpoint takes: bytes, averages, axes, stacks."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations.cameras import SplatRgbObservation
from nw_eval.memory import Arrays
from nw_eval.sensors.wrappers.wrapper import Shot

Bytes = NDArray[np.uint8]


def image_shape(observation: SplatRgbObservation) -> tuple[int, ...]:
    """Return the shape of an observation, stack included."""
    size = (observation.height, observation.width)
    channels = 3 * (observation.stack if observation.stack_axis == "channel" else 1)
    frame = (*size, channels) if observation.axes == "hwc" else (channels, *size)
    if observation.stack > 1 and observation.stack_axis == "new":
        return (observation.stack, *frame)
    return frame


class Arrange:
    """Lays images out as the card says, with those before them."""

    def __init__(self, observation: SplatRgbObservation) -> None:
        self._observation = observation
        self._frames: deque[Bytes] = deque(maxlen=observation.stack)
        # What the next observations share with this one.
        self._laid_out: deque[NDArray[Any]] = deque(maxlen=observation.stack)

    def __call__(self, sample: Bytes, shot: Shot) -> NDArray[Any]:  # noqa: ARG002 - as every wrapper.
        """Add an image (H, W, 3) and return the observation."""
        # The first image stands for those before it.
        self._add([sample] * (1 if self._frames else self._observation.stack))
        return _stacked(self._laid_out, self._observation)

    def reset(self, rng: np.random.Generator) -> None:  # noqa: ARG002 - nothing here is random.
        """Forget earlier images."""
        self._frames.clear()
        self._laid_out.clear()

    def state(self) -> Arrays:
        """Return the images."""
        return {"frames": np.stack(self._frames)} if self._frames else {}

    def restore(self, state: Arrays) -> None:
        """Go back to images."""
        self._frames.clear()
        self._laid_out.clear()
        if state:
            self._add(state["frames"])

    def _add(self, frames: Iterable[Bytes]) -> None:
        for frame in frames:
            self._frames.append(frame)
            self._laid_out.append(_laid_out(frame, self._observation))


def average_blocks(image: Bytes) -> Bytes:
    """Return the mean of each 2 x 2 block, halves up: (2H, 2W, 3) to (H, W, 3) bytes.

    floor((a + b + c + d + 2) / 4) is what OpenCV's bilinear resize by a factor of 16 gives for the
    four pixels at the centre of each cell.
    """
    wide = image.astype(np.uint16)
    total = wide[0::2, 0::2] + wide[0::2, 1::2] + wide[1::2, 0::2] + wide[1::2, 1::2]
    return ((total + 2) // 4).astype(np.uint8)


def arrange(frames: list[Bytes], observation: SplatRgbObservation) -> NDArray[Any]:
    """Return frames (H, W, 3), oldest first, as the card lays them out."""
    return _stacked([_laid_out(frame, observation) for frame in frames], observation)


def _laid_out(frame: Bytes, observation: SplatRgbObservation) -> NDArray[Any]:
    image: NDArray[Any] = frame
    if observation.dtype == "float32":
        image = (frame.astype(np.float32) - np.float32(observation.mean)) / np.float32(
            observation.std
        )
    return image.transpose(2, 0, 1) if observation.axes == "chw" else image


def _stacked(images: Sequence[NDArray[Any]], observation: SplatRgbObservation) -> NDArray[Any]:
    if observation.stack_axis == "channel":
        return np.concatenate(images, axis=-1 if observation.axes == "hwc" else 0)
    return np.stack(images) if observation.stack > 1 else np.ascontiguousarray(images[0])
