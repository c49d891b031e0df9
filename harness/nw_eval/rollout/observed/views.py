"""How the log shows each observation that is a camera's image: as what the policy was given.

Axes, stacks and types are the checkpoint's affair; a picture for people has rows, columns and
colours. Of a stack the newest image is shown: the others were, when they were new.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from math import prod
from typing import TYPE_CHECKING, Any, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards import wrappers
from nw_eval.cards.observations import (
    CameraObservation,
    DepthObservation,
    SemanticsObservation,
    SplatRgbObservation,
)

if TYPE_CHECKING:
    from nw_eval.cards import Card
    from nw_eval.robots import CameraMount
    from nw_eval.rollout.mcap.content.images import Form

Image = NDArray[Any]

_COLOURS = 3
_PLAIN = re.compile(r"[\w.-]{1,100}")
# After these a pixel's unit still is what it was.
_FAITHFUL = (
    wrappers.NoiseWrap
    | wrappers.Crop
    | wrappers.Resize
    | wrappers.Clip
    | wrappers.Quantize
    | wrappers.Stack
    | wrappers.Channels
)


@dataclass(frozen=True, kw_only=True)
class Pinhole:
    """A camera's image: size and focal lengths and centre, all in pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, kw_only=True)
class View:
    """One observation of a camera, as the log shows it.

    Attributes:
        observation: its name on the card.
        topic: the log's name for it.
        mount: the robot's camera.
        spec: what the card says.
    """

    observation: str
    topic: str
    mount: str
    spec: CameraObservation

    def pictures(self, array: Image) -> list[tuple[Form, Image]]:
        """Return the newest sample of an observation: (H, W) or (H, W, 3) images, one or more.

        A wrapper of somebody else's may make several images of one; each is shown. Nothing is, if
        no axes are left that could be rows and columns.
        """
        if array.ndim < 2:
            return []
        planes = self._planes(array)
        step = _COLOURS if self._in_colour and planes.shape[-1] % _COLOURS == 0 else 1
        count = planes.shape[-1] // step
        images = [planes[..., k * step : (k + 1) * step] for k in range(count)]
        newest = images[-max(1, count // self._frames) :]
        return [self._form(image[..., 0] if step == 1 else image) for image in newest]

    def pinhole(self, mount: CameraMount) -> Pinhole | None:
        """Return the calibration of the pictures; None after a wrapper that may bend images."""
        if any(
            isinstance(wrapper, wrappers.Flatten | wrappers.PluginWrap)
            for wrapper in self.spec.wrap
        ):
            return None
        return self._traced(mount.fovy)

    @property
    def _size(self) -> tuple[int, int]:
        """Rows and columns behind the wrappers, as far as those are ours."""
        seen = self._traced(1.0)
        return seen.height, seen.width

    def _traced(self, fovy: float) -> Pinhole:
        """Return the camera behind all crops and changes of size; `fovy` in rad."""
        spec = self.spec
        focal = 0.5 * spec.height / float(np.tan(0.5 * fovy))
        seen = Pinhole(
            width=spec.width,
            height=spec.height,
            fx=focal,
            fy=focal,
            cx=0.5 * spec.width,
            cy=0.5 * spec.height,
        )
        for wrapper in spec.wrap:
            match wrapper:
                case wrappers.Crop():
                    seen = Pinhole(
                        width=seen.width - wrapper.left - wrapper.right,
                        height=seen.height - wrapper.top - wrapper.bottom,
                        fx=seen.fx,
                        fy=seen.fy,
                        cx=seen.cx - wrapper.left,
                        cy=seen.cy - wrapper.top,
                    )
                case wrappers.Resize():
                    across, down = wrapper.width / seen.width, wrapper.height / seen.height
                    seen = Pinhole(
                        width=wrapper.width,
                        height=wrapper.height,
                        fx=seen.fx * across,
                        fy=seen.fy * down,
                        cx=seen.cx * across,
                        cy=seen.cy * down,
                    )
                case (
                    wrappers.NoiseWrap()
                    | wrappers.Normalize()
                    | wrappers.Scale()
                    | wrappers.Clip()
                    | wrappers.Grayscale()
                    | wrappers.Quantize()
                    | wrappers.Stack()
                    | wrappers.Channels()
                    | wrappers.Flatten()
                    | wrappers.PluginWrap()
                ):
                    pass
                case _:
                    assert_never(wrapper)
        return seen

    @property
    def _in_colour(self) -> bool:
        if any(isinstance(wrapper, wrappers.Grayscale) for wrapper in self.spec.wrap):
            return False
        spec = self.spec
        if isinstance(spec, SemanticsObservation):
            return spec.values == "colors"
        return isinstance(spec, SplatRgbObservation)

    @property
    def _frames(self) -> int:
        """How many samples an observation holds."""
        stacks = [
            wrapper.steps for wrapper in self.spec.wrap if isinstance(wrapper, wrappers.Stack)
        ]
        own = self.spec.stack if isinstance(self.spec, SplatRgbObservation) else 1
        return own * prod(stacks)

    def _planes(self, array: Image) -> Image:
        """Return (H, W, all else), oldest sample first and colours together."""
        pairs = list(pairwise(array.shape))
        # Of an image of unknown size, rows and columns are the two that make most pixels.
        rows = pairs.index(self._size if self._size in pairs else max(pairs, key=prod))
        array = np.moveaxis(array, (rows, rows + 1), (0, 1))
        stacks = [wrapper.axis for wrapper in self.spec.wrap if isinstance(wrapper, wrappers.Stack)]
        if self._in_colour and stacks[-1:] == ["last"]:
            array = np.moveaxis(array, -1, 2)  # The colours stood before the samples.
        return array.reshape(*array.shape[:2], -1)

    def _form(self, image: Image) -> tuple[Form, Image]:
        spec = self.spec
        if image.ndim == _COLOURS:
            is_drawn = isinstance(spec, SemanticsObservation) and _is_bytes(image)
            return ("drawing", image) if is_drawn else ("photo", self._bytes(image))
        if isinstance(spec, SemanticsObservation) and spec.values == "ids" and _is_bytes(image):
            return "classes", image
        is_metric = isinstance(spec, DepthObservation) and spec.mode == "metres"
        if is_metric and all(isinstance(wrapper, _FAITHFUL) for wrapper in spec.wrap):
            return "metres", image
        return ("grey", image) if _is_bytes(image) else ("numbers", image)

    def _bytes(self, image: Image) -> NDArray[np.uint8]:
        """Return colours as bytes: exactly where the card says how they became numbers."""
        spec = self.spec
        if _is_bytes(image):
            return image
        if isinstance(spec, SplatRgbObservation) and spec.dtype == "float32" and not spec.wrap:
            image = image * spec.std + spec.mean
        else:  # From the darkest to the brightest.
            low, high = float(np.nanmin(image)), float(np.nanmax(image))
            image = (image - low) * (255.0 / max(high - low, 1e-12))
        return np.clip(np.rint(np.nan_to_num(image)), 0.0, 255.0).astype(np.uint8)


def topic_names(card: Card) -> dict[str, str]:
    """Return what stands for each observation in topics: its name, if that is a plain word.

    A card may be a stranger's, and `calib` is taken by calibrations.
    """
    return {
        name: name if _PLAIN.fullmatch(name) and name != "calib" else f"~{number}"
        for number, name in enumerate(card.observations)
    }


def views_of(card: Card) -> tuple[View, ...]:
    """Return the views of a card's cameras, in its order.

    The first photograph from a camera is `/camera/<camera>`, every other image
    `/camera/<camera>/<observation>`.
    """
    found: list[View] = []
    names = topic_names(card)
    for name, spec in card.observations.items():
        if not isinstance(spec, CameraObservation):
            continue
        topic = f"/camera/{spec.camera}"
        is_first = isinstance(spec, SplatRgbObservation) and topic not in {v.topic for v in found}
        found.append(
            View(
                observation=name,
                topic=topic if is_first else f"{topic}/{names[name]}",
                mount=spec.camera,
                spec=spec,
            )
        )
    return tuple(found)


def _is_bytes(image: Image) -> bool:
    return image.dtype == np.uint8
