"""The observations that a card can name: which sensor, and how its values are laid out."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from nw_eval.policies.layouts import LAYOUTS, LayoutName
from nw_eval.policies.model import CONTROL_RATE, CardModel, Latency, Limits, Rate
from nw_eval.policies.terms import AnyTerm, Term


class _Observation(CardModel):
    rate: Rate = CONTROL_RATE
    """Samples per second; between two of them the last one is held."""
    latency: Latency = 0.0
    """Age of a sample when the policy first sees it, s."""


class History(CardModel):
    """Earlier frames that an observation carries along."""

    steps: int = Field(ge=1, le=100)
    """Number of frames."""
    order: Literal["oldest_first", "newest_first"] = "oldest_first"
    by: Literal["step", "term"] = "step"
    """`step`: frame after frame. `term`: all frames of the first term, then of the second, ..."""
    current: bool = True
    """Whether the newest frame is the present one; False = earlier frames only."""
    start: Literal["repeat", "zeros"] = "repeat"
    """What stands for frames before the first: the first frame, or zeros."""


def _steps_only(value: Any) -> Any:
    """Read `history: 6` as `{steps: 6}`."""
    return {"steps": value} if isinstance(value, int) else value


class ProprioObservation(_Observation):
    """Numbers of the body: a named layout or a list of terms."""

    sensor: Literal["proprio"]
    layout: LayoutName | None = None
    terms: Annotated[list[Term], Field(min_length=1, max_length=100)] | None = None
    clip: Limits | None = None
    """Limits of every number after scaling."""
    select: Annotated[list[int | str], Field(min_length=1)] | None = None
    """Which numbers of a frame are kept: indices and ranges such as "13:53" (end excluded)."""
    history: Annotated[History, BeforeValidator(_steps_only)] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> ProprioObservation:
        if (self.layout is None) == (self.terms is None):
            raise ValueError("a proprio observation needs `layout` or `terms`; give one of them")
        if self.select is not None and self.history is not None and self.history.by == "term":
            raise ValueError("`select` mixes terms; use `history: {by: step}` with it")
        return self

    @property
    def frame_terms(self) -> tuple[AnyTerm, ...]:
        """The terms of one frame."""
        if self.layout is not None:
            return LAYOUTS[self.layout]
        return tuple(self.terms or ())


class ScandotsObservation(_Observation):
    """Heights of the ground around the robot: clip(trunk_z + offset - ground_z), m.

    The points stand in a frame at the trunk origin that turns with the yaw only, x-major, both
    axes ascending.
    """

    sensor: Literal["scandots"]
    x: tuple[float, float, Annotated[int, Field(ge=1, le=200)]] = (-0.45, 1.2, 12)
    """First, last and number of points ahead, m."""
    y: tuple[float, float, Annotated[int, Field(ge=1, le=200)]] = (-0.75, 0.75, 11)
    """First, last and number of points to the left, m."""
    offset: float = 0.0143 - 0.3
    """Added to the trunk's height, m. The 0.3 is extreme-parkour's; the 0.0143 is how far the
    published virtual camera on a Go1 stands from 25 m above the trunk in the default stance (it
    follows the centre of mass; on a Go2 it is 0.0170)."""
    clip: Limits = (-1.0, 1.0)


class SplatRgbObservation(_Observation):
    """A photographic image of the scene's splat from a camera of the robot."""

    sensor: Literal["splat_rgb"]
    camera: str = "ego"
    width: int = Field(default=80, ge=8, le=1920)
    height: int = Field(default=45, ge=8, le=1080)
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
    dtype: Literal["uint8", "float32"] = "uint8"
    mean: float = 0.0
    std: float = 255.0
    """float32 images are (byte - mean) / std."""

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


AnyObservation = ProprioObservation | ScandotsObservation | SplatRgbObservation
Observation = Annotated[AnyObservation, Field(discriminator="sensor")]


def selected_indices(select: list[int | str], size: int) -> list[int]:
    """Return the indices that a `select` list names in a frame of `size` numbers.

    Raises:
        ValueError: an entry is no index or range, or lies outside the frame.
    """
    indices: list[int] = []
    for entry in select:
        first, colon, last = str(entry).partition(":")
        try:
            start = int(first)
            stop = int(last) if colon else start + 1
        except ValueError:
            message = f"select: {entry!r} is no index or range; write 7 or 13:53"
            raise ValueError(message) from None
        if not 0 <= start < stop <= size:
            message = f"select: {entry!r} is outside the {size} numbers of the frame"
            raise ValueError(f"{message}; counts start at 0, ends are excluded")
        indices.extend(range(start, stop))
    return indices
