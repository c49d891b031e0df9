"""From rendered floats to the array that a checkpoint takes: bytes, averages, axes, stacks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.policies.observations import SplatRgbObservation

Bytes = NDArray[np.uint8]


def image_shape(observation: SplatRgbObservation) -> tuple[int, ...]:
    """Return the shape of an observation, stack included."""
    size = (observation.height, observation.width)
    channels = 3 * (observation.stack if observation.stack_axis == "channel" else 1)
    frame = (*size, channels) if observation.axes == "hwc" else (channels, *size)
    if observation.stack > 1 and observation.stack_axis == "new":
        return (observation.stack, *frame)
    return frame


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
    images: list[NDArray[Any]] = list(frames)
    if observation.dtype == "float32":
        mean, std = np.float32(observation.mean), np.float32(observation.std)
        images = [(image.astype(np.float32) - mean) / std for image in images]
    if observation.axes == "chw":
        images = [image.transpose(2, 0, 1) for image in images]
    if observation.stack_axis == "channel":
        return np.concatenate(images, axis=-1 if observation.axes == "hwc" else 0)
    return np.stack(images) if observation.stack > 1 else np.ascontiguousarray(images[0])
