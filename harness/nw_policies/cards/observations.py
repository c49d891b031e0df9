"""The observations that a card can name: which sensor, and how its values are laid out.

A sensor that stands in `BuiltInObservation` can be named by cards.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from nw_base.plugins import SENSORS, known_or_raise
from nw_policies.cards.model import CONTROL_RATE, CardModel, Latency, Limits, Rate
from nw_policies.cards.reference_terms import AnyReferenceTerm, ReferenceTerm
from nw_policies.cards.terms import LAYOUTS, AnyTerm, LayoutName, Term
from nw_policies.cards.wrappers import NamedBy, Noise, Wrapper, names_of


class BaseObservation(CardModel):
    """Sampled at a rate, delivered after a latency.

    A sample is measured, gets its noise, is brought into the form that the card asks for (points
    of a scanner, stacks, earlier frames) and then passes through the wrappers in order.
    """

    rate: Rate = CONTROL_RATE
    """Samples per second; between two of them the last one is held."""
    latency: Latency = 0.0
    """Age of a sample when the policy first sees it, s."""
    noise: Noise | None = None
    """Of the measurement, drawn from the trial's own stream for this observation."""
    wrap: list[Wrapper] = Field(default_factory=list[Wrapper], max_length=20)
    """What happens to a sample before the policy sees it, in this order."""

    @property
    def needs_splat(self) -> bool:
        """Whether it is measured on the scene's splat."""
        return False


Select = Annotated[list[int | str], Field(min_length=1)]
"""Indices and ranges such as "13:53" (end excluded)."""


class History(CardModel):
    """Earlier frames that an observation carries along."""

    steps: int = Field(ge=1, le=100)
    """Number of frames."""
    order: Literal["oldest_first", "newest_first"] = "oldest_first"
    """Which frame stands at the front."""
    by: Literal["step", "term"] = "step"
    """`step`: frame after frame. `term`: all frames of the first term, then of the second, ..."""
    current: bool = True
    """Whether the newest frame is the present one; False = earlier frames only."""
    start: Literal["repeat", "zeros"] = "repeat"
    """What stands for frames before the first: the first frame, or zeros."""
    zero: list[int | str] | None = None
    """Which numbers of a frame (as in `select`) read 0 in the history, such as a heading that
    training kept out of it."""


def _steps_only(value: Any) -> Any:
    """Read `history: 6` as `{steps: 6}`."""
    return {"steps": value} if isinstance(value, int) else value


class ProprioObservation(BaseObservation):
    """Numbers of the body: a named layout or a list of terms."""

    sensor: Literal["proprio"]
    layout: LayoutName | None = None
    """A published list of terms, in place of `terms`."""
    terms: Annotated[list[Term], Field(min_length=1, max_length=100)] | None = None
    """The groups of numbers that make a frame, in this order."""
    clip: Limits | None = None
    """Limits of every number after scaling."""
    select: Select | None = None
    """Which numbers of a frame are kept: indices and ranges such as "13:53" (end excluded)."""
    history: Annotated[History, BeforeValidator(_steps_only)] | None = None
    """Earlier frames that go along, or just their number; null = the present frame alone."""

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


Ahead = Annotated[int, Field(ge=-1000, le=1000)]


class ReferenceObservation(BaseObservation):
    """Numbers of the motion that the policy tracks, which the card's `reference` names."""

    sensor: Literal["reference"]
    terms: Annotated[list[ReferenceTerm], Field(min_length=1, max_length=20)]
    """The groups of numbers of one frame, in this order."""
    ahead: Annotated[tuple[Ahead, ...], Field(min_length=1, max_length=100)] = (0,)
    """Frames that are seen, one behind the other: how many control steps each lies ahead. 0 = the
    frame of this instant; trainings in whole_body_tracking and mjlab show 1, the frame that the
    next step is to reach. Beyond its ends the motion stands still."""
    clip: Limits | None = None
    """Limits of every number after scaling."""
    history: Annotated[History, BeforeValidator(_steps_only)] | None = None
    """Earlier frames that go along, or just their number; null = the present frame alone."""

    @property
    def frame_terms(self) -> tuple[tuple[AnyReferenceTerm, int], ...]:
        """The terms of one frame, each with how many control steps it lies ahead."""
        return tuple((term, steps) for steps in self.ahead for term in self.terms)


def selected_indices(select: list[int | str], size: int, *, of: str = "frame") -> list[int]:
    """Return the indices that a `select` list names in a frame, or what else, of `size` numbers.

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
            message = f"select: {entry!r} is not an index or range; write 7 or 13:53"
            raise ValueError(message) from None
        if not 0 <= start < stop <= size:
            message = f"select: {entry!r} is outside the {size} numbers of the {of}"
            raise ValueError(f"{message}; counts start at 0, ends are excluded")
        indices.extend(range(start, stop))
    return indices


Axis = tuple[float, float, Annotated[int, Field(ge=1, le=500)]]
"""First, last and number of points, m."""
GridOrder = Literal["y_fastest", "x_fastest"]
"""Which coordinate changes from each number of a row to the next."""


class ScandotsObservation(BaseObservation):
    """Heights of the ground around the robot: clip(trunk_z + offset - ground_z), m.

    The points stand in a frame at the trunk origin that turns with the yaw only. Both axes ascend:
    the first number lies behind and to the right of the robot.
    """

    sensor: Literal["scandots"]
    x: Axis = (-0.45, 1.2, 12)
    """First, last and number of points ahead, m."""
    y: Axis = (-0.75, 0.75, 11)
    """First, last and number of points to the left, m."""
    offset: float = 0.0143 - 0.3
    """Added to the trunk's height, m. The 0.3 is extreme-parkour's; the 0.0143 is how far the
    published virtual camera on a Go1 stands from 25 m above the trunk in the default stance (it
    follows the centre of mass; on a Go2 it is 0.0170)."""
    order: GridOrder = "y_fastest"
    """`y_fastest`: from right to left, then the next row ahead. `x_fastest`: from behind to ahead,
    then the next column to the left, as the grids of Isaac Lab and mjlab (their ordering `xy`)."""
    clip: Limits = (-1.0, 1.0)
    """Limits of every number, m; where there is no ground, the upper one is read."""

    @model_serializer(mode="wrap")
    def _without_the_usual_order(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave the default `order` out, so that cards without the key keep their digest."""
        fields = dump(self)
        if self.order == "y_fastest":
            fields.pop("order", None)
        return fields


class HeightmapObservation(BaseObservation):
    """A map of ground heights around the robot, (x, y) with x ahead and y to the left, m.

    The grid turns with the yaw only. Both axes ascend, so row 0 lies behind the robot and column 0
    to its right. `scandots` is the same grid, flattened and counted downwards from the trunk.
    """

    sensor: Literal["heightmap"]
    x: Axis = (-1.0, 2.0, 31)
    """First, last and number of points ahead, m."""
    y: Axis = (-1.0, 1.0, 21)
    """First, last and number of points to the left, m."""
    relative_to: Literal["trunk", "ground", "world"] = "trunk"
    """Heights are those above the trunk's origin, above the ground under it, or above z = 0."""
    clip: Limits = (-2.0, 2.0)
    """Where there is no ground, the map reads the lower limit."""


Columns = Annotated[int, Field(ge=8, le=1920)]
Rows = Annotated[int, Field(ge=8, le=1080)]


class SplatRgbObservation(BaseObservation):
    """A rendering of the scene's splat from a camera of the robot."""

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

    @property
    def needs_splat(self) -> bool:
        """It is a picture of the scene's splat."""
        return True

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


class Stereo(CardModel):
    """Depth as a stereo camera of Intel's RealSense D400 family finds it; by default a D435.

    With f the focal length in pixels of the matched images, B the baseline and Z the depth, the
    disparity is f B / Z. It has a random error, is a multiple of 1/32 pixel, and at most
    `disparities`. A pixel has no depth where the right imager does not see what the left one does:
    behind nearer edges, and in a band f B / Z wide at the left border.
    Sources: Intel, D400 series data sheet 337029 (minimum Z, invalid depth band, ideal ranges);
    "Tuning depth cameras for best performance" (Z^2 subpixel / (f B), minimum Z); "Subpixel
    linearity improvement" (1/32 pixel).
    """

    baseline: float = Field(default=0.05, gt=0.0, le=1.0)
    """Distance of the right imager from the left one, which is the camera, m. D415 0.055, D455
    0.095, D405 0.018."""
    matched_width: int = Field(default=848, ge=8, le=4096)
    """Columns of the images that are matched; the observation's is that depth image, resized."""
    disparities: int = Field(default=126, ge=1, le=1024)
    """Most pixels of disparity: nearer than f B / disparities there is no depth."""
    subpixel: float = Field(default=0.08, ge=0.0, le=2.0)
    """Standard deviation of the disparity, pixels. Intel: below 0.1 is usual, 0.05 with good
    texture."""
    max_range: float = Field(default=10.0, gt=0.0, le=65.535)
    """Farther there is no depth, m."""
    units: float = Field(default=0.001, gt=0.0, le=0.1)
    """Depth is a multiple of it, m."""
    invalid: float = Field(default=0.0, ge=0.0)
    """What a pixel without depth reads, m; the camera's own files have 0."""


Source = Literal["geometry", "splat"]
"""`geometry`: the mesh, as feet and rays meet it. `splat`: where its Gaussians cover half of a
pixel or more, which shows what a mesh lacks, such as poles and leaves; elsewhere nothing is met."""

STEEPEST = 1.05
"""Elevation of a scanner's rays on a splat, rad, at most."""


def _without_geometry(fields: dict[str, Any]) -> dict[str, Any]:
    if fields.get("source") == "geometry":
        fields.pop("source")
    return fields


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
    stereo: Stereo | None = None
    """What a stereo camera makes of the depth; null = every pixel has its exact depth."""
    source: Source = "geometry"
    """What of the scene is met."""

    @property
    def needs_splat(self) -> bool:
        """Whether the scene is its splat."""
        return self.source == "splat"

    @model_validator(mode="after")
    def _pixels_of_their_own(self) -> DepthObservation:
        if self.stereo is not None and self.source == "splat":
            raise ValueError(
                "`stereo` casts rays from its second imager, and a splat has no rays; drop it, or "
                "`source: splat`"
            )
        if self.stereo is not None and self.supersample > 1:
            raise ValueError(
                "`supersample` averages rays, and pixels of `stereo` without depth have no mean; "
                "drop one of them"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_exact_depth(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave defaults of later keys out, so that cards without them keep their digest."""
        fields = dump(self)
        if self.stereo is None:
            fields.pop("stereo", None)
        return _without_geometry(fields)


class SemanticsObservation(_GeometryView):
    """What each pixel shows: class ids (height, width) uint8, or their colours.

    0 nothing, 1 ground, 2 obstacle, 3 structure, 4 clutter, 5 overhead, 6 cone, 7 robot.
    """

    sensor: Literal["semantics"]
    values: Literal["ids", "colors"] = "ids"
    """`colors`: (height, width, 3) uint8 of the palette in `sensors.drawing.pictures`."""


CameraObservation = SplatRgbObservation | DepthObservation | SemanticsObservation
"""All that are images of a camera of the robot; logs show them as pictures."""


class Mount(CardModel):
    """Where a sensor sits on the trunk."""

    position: tuple[float, float, float] = (0.2, 0.0, 0.12)
    """Trunk frame, m."""
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of the sensor's frame in the trunk's, rad; level = (0, 0, 0)."""


class LidarObservation(BaseObservation):
    """A laser scanner: points in the sensor's frame (x ahead, y left, z up), float32 m.

    All rays of a sample leave at one instant: a scan is not bent by the robot's motion.
    Points are (channels, columns, 3): channels from the lowest up, columns from right to left.
    """

    sensor: Literal["lidar"]
    pattern: Literal["spinning", "solid_state"] = "spinning"
    """`spinning`: channels at equal steps of elevation, columns at equal steps of azimuth around
    the whole circle, beginning behind the sensor. `solid_state`: a rectangle, equally spaced in
    the plane ahead, as flash sensors have it."""
    channels: int = Field(default=16, ge=1, le=512)
    """Rays above one another."""
    columns: int = Field(default=1800, ge=1, le=4096)
    """Rays beside one another."""
    elevation: Limits = (-0.2618, 0.2618)
    """Lowest and highest channel, rad."""
    azimuth: Limits | None = None
    """Rightmost and leftmost column, rad; null = the whole circle, or -0.6 to 0.6 of a rectangle.
    """
    mount: Mount = Mount()
    """Where it sits on the trunk."""
    min_range: float = Field(default=0.1, ge=0.0)
    """Nearer surfaces give no point, m."""
    max_range: float = Field(default=30.0, gt=0.0)
    """Farther ones neither, m."""
    values: Literal["points", "ranges"] = "points"
    """`ranges`: (channels, columns), the distances along the rays."""
    miss: Literal["nan", "max_range"] = "nan"
    """What a ray gives that meets nothing within range: NaN, or a point at `max_range`."""
    cones: bool = False
    """Whether a traffic cone stands on each waypoint."""
    robot: bool = False
    """Whether the robot's own legs are seen; never the trunk that carries the sensor."""
    source: Source = "geometry"
    """What of the scene is met."""

    @property
    def needs_splat(self) -> bool:
        """Whether the scene is its splat."""
        return self.source == "splat"

    @model_validator(mode="after")
    def _flat_enough(self) -> LidarObservation:
        if self.source == "splat" and max(map(abs, self.elevation)) > STEEPEST:
            raise ValueError(
                f"`source: splat` takes rays of at most {STEEPEST} rad up or down, not "
                f"{max(self.elevation, key=abs):g}; narrow `elevation`"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_default_source(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave `geometry` out, so that cards without the key keep their digest."""
        return _without_geometry(dump(self))


class DirectionObservation(BaseObservation):
    """Angle from the heading to the next waypoint, rad in [-pi, pi), positive to the left."""

    sensor: Literal["direction"]
    values: Literal["angle", "sine_cosine"] = "angle"
    """`angle`: (1,). `sine_cosine`: (2,), without the jump behind the robot."""


BuiltInObservation = (
    ProprioObservation
    | ReferenceObservation
    | ScandotsObservation
    | HeightmapObservation
    | SplatRgbObservation
    | DepthObservation
    | SemanticsObservation
    | LidarObservation
    | DirectionObservation
)
"""What measures each of them stands in `sensors.build`."""

BUILT_IN_SENSORS = names_of(BuiltInObservation, "sensor")


class PluginObservation(BaseObservation):
    """An installed plug-in of the group `nw_eval.sensors`, or `module:Class`.

    Every key that this class does not have is a parameter of the plug-in's class.
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    sensor: str
    """Name of an installed sensor, or `module:Class`."""

    @model_validator(mode="after")
    def _known(self) -> PluginObservation:
        known_or_raise(self.sensor, SENSORS, BUILT_IN_SENSORS)
        return self

    @property
    def parameters(self) -> dict[str, Any]:
        """Keyword arguments of its class."""
        return dict(self.model_extra or {})


AnyObservation = BuiltInObservation | PluginObservation
Observation = Annotated[AnyObservation, NamedBy("sensor")]
