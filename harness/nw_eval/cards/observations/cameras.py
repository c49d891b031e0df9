"""Images: renderings of the splat, depth, and classes."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from nw_eval.cards.observations.base import BaseObservation

Columns = Annotated[int, Field(ge=8, le=1920)]
Rows = Annotated[int, Field(ge=8, le=1080)]


class SplatRgbObservation(BaseObservation):
    """A rendering of the scene's splat from a camera of the robot."""

    needs_splat: ClassVar[bool] = True

    sensor: Literal["splat_rgb"]
    camera: str = "ego"
    """Name of a camera of the robot."""
    width: Columns = 80
    """Columns of the image, pixels."""
    height: Rows = 45
    """Rows of the image, pixels; they span the camera's vertical field of view."""
    sampling: Literal["full", "published"] = "full"
    """`full`: a camera of this size. `published`: 80 x 45 from the centres of 16 x 16 cells of a
    1280 x 720 image, truncated to bytes before averaging, as the published evaluation does it."""
    cones: bool = False
    """Whether a traffic cone stands on each waypoint."""
    robot: bool = False
    """Whether the robot's own body is seen; it never is in published images."""
    stack: int = Field(default=1, ge=1, le=32)
    """Number of samples, oldest first; the first sample stands for those before it."""
    stack_axis: Literal["new", "channel"] = "new"
    """`new`: a leading axis of its own (none for a stack of 1). `channel`: along the channels."""
    axes: Literal["hwc", "chw"] = "hwc"
    """Whether the three colours come last or first."""
    dtype: Literal["uint8", "float32"] = "uint8"
    """uint8 images are sRGB bytes, float32 images (byte - mean) / std."""
    mean: float = 0.0
    """Subtracted from the bytes of float32 images."""
    std: float = 255.0
    """What float32 images are divided by after that."""

    @model_validator(mode="after")
    def _published_size(self) -> SplatRgbObservation:
        if self.sampling == "published" and (self.width, self.height) != (80, 45):
            size = f"{self.width} x {self.height}"
            raise ValueError(f"`sampling: published` makes 80 x 45 images, not {size}; drop one")
        if self.sampling == "published" and self.robot:
            raise ValueError("published images never show the robot; drop `robot` or `sampling`")
        if self.std == 0.0:
            raise ValueError("std is 0; give the divisor of the image's bytes, e.g. 255")
        return self


class _GeometryView(BaseObservation):
    camera: str = "ego"
    """Name of a camera of the robot."""
    width: Columns = 80
    """Columns of the image, pixels."""
    height: Rows = 45
    """Rows of the image, pixels; they span the camera's vertical field of view."""
    cones: bool = False
    """Whether a traffic cone stands on each waypoint."""
    robot: bool = False
    """Whether the robot's own body is seen; never the trunk that carries the camera."""


class DepthObservation(_GeometryView):
    """Depth along the optical axis of the scene's geometry, (height, width) float32."""

    sensor: Literal["depth"]
    mode: Literal["metres", "linear", "midas"] = "metres"
    """`metres`. `linear`: clipped to `clip` and divided by it, so that 1 is that far or farther.
    `midas`: 1 / depth, stretched from 0 to 1 in each frame, as a monocular estimator gives it."""
    clip: float = Field(default=5.0, gt=0.0)
    """m; of `linear` only."""
    far: float = Field(default=50.0, gt=0.0)
    """What pixels read that see nothing, and the farthest that others do, m."""
    supersample: int = Field(default=1, ge=1, le=8)
    """Rays along each side of a pixel, whose values are averaged. 4 with 320 x 180 gives the
    published depth image, which is 1280 x 720 and reduced by area."""


class SemanticsObservation(_GeometryView):
    """What each pixel shows: class ids (height, width) uint8, or their colours.

    0 nothing, 1 ground, 2 obstacle, 3 structure, 4 clutter, 5 overhead, 6 cone, 7 robot.
    """

    sensor: Literal["semantics"]
    values: Literal["ids", "colors"] = "ids"
    """`colors`: (height, width, 3) uint8 of the palette in `sensors.palette`."""


CameraObservation = SplatRgbObservation | DepthObservation | SemanticsObservation
"""All that are images of a camera of the robot; logs show them as pictures."""
