"""The wrappers that a card can put around an observation. `sensors.wrappers` implements them.

    wrap: [grayscale, {wrapper: resize, width: 40, height: 24}, {wrapper: my_pkg:Diffuse, steps: 4}]

A wrapper of one's own has any name that is installed in the entry-point group `nw_eval.wrappers`,
or is written `module:Class`; every further key of it is a parameter of its class.

Wrappers and sensors are unions of models that are told apart by a name: what is built in, and one
model for the rest. The union is the table: each model says its own name, as the `Literal` of one of
its keys. From that follow the names that are built in, the branch that a mapping falls into, and
the JSON Schema. The names of installed packages are looked up in `nw_base.plugins`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from nw_base.plugins import WRAPPERS, known_or_raise
from nw_policies.cards.model import CardModel, Limits

PLUGIN = "plug-in"
"""The branch that everything falls into which is not built in."""


def names_of(union: Any, key: str) -> tuple[str, ...]:
    """Return the names of a union's models, in its order.

    Args:
        union: of models.
        key: where a model has its name: a `Literal` of one word.
    """
    return tuple(_name_of(model, key) for model in get_args(union))


@dataclass(frozen=True)
class NamedBy:
    """Marks a union whose models have their names under `key`; the one without is the plug-ins'."""

    key: str

    def __get_pydantic_core_schema__(self, union: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema that looks at the name and then reads as that model alone."""
        branches = {
            _name_of(model, self.key): handler.generate_schema(model) for model in get_args(union)
        }

        def branch_of(value: Any) -> str | None:
            is_mapping = isinstance(value, dict)
            name = value.get(self.key) if is_mapping else getattr(value, self.key, None)
            if not isinstance(name, str):
                return None
            return name if name in branches else PLUGIN

        return core_schema.tagged_union_schema(branches, branch_of)


def _name_of(model: type[BaseModel], key: str) -> str:
    names = get_args(model.model_fields[key].annotation)
    return names[0] if names else PLUGIN


Pixels = Annotated[int, Field(ge=0, le=4096)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class Noise(CardModel):
    """Random errors of single numbers, in the unit of the sample.

    value * (1 + proportional * n1) + gaussian * n2 with standard normal n1 and n2; then each
    number is lost with the probability `dropout`, and reads `lost`.
    """

    gaussian: float = Field(default=0.0, ge=0.0)
    """Standard deviation."""
    proportional: float = Field(default=0.0, ge=0.0)
    """Standard deviation as a share of the value."""
    dropout: Share = 0.0
    """Share of the numbers (of an image: of its pixels) that is lost."""
    lost: float | Literal["nan"] | None = None
    """What a lost number reads; null = what the sensor reads where there is nothing: its far end
    for depth, a miss for a lidar, 0 for the rest."""


class NoiseWrap(Noise):
    """`Noise` at its place in the chain."""

    wrapper: Literal["noise"]


class Crop(CardModel):
    """Cut rows and columns off an image."""

    wrapper: Literal["crop"]
    top: Pixels = 0
    """Rows cut off at the top."""
    bottom: Pixels = 0
    """Rows cut off at the bottom."""
    left: Pixels = 0
    """Columns cut off on the left."""
    right: Pixels = 0
    """Columns cut off on the right."""


class Resize(CardModel):
    """Give an image another size."""

    wrapper: Literal["resize"]
    width: int = Field(ge=1, le=4096)
    """New number of columns, pixels."""
    height: int = Field(ge=1, le=4096)
    """New number of rows, pixels."""
    method: Literal["area", "bilinear", "nearest"] = "area"
    """`area`: the mean of what a new pixel covers. `bilinear`: between pixel centres, without
    antialiasing. `nearest`: the pixel under the new one's centre."""


class Normalize(CardModel):
    """(value - mean) / std as float32; lists hold one number for each colour."""

    wrapper: Literal["normalize"]
    mean: float | list[float] = 0.0
    """What is subtracted."""
    std: float | list[float] = 255.0
    """What is divided by after that."""

    @model_validator(mode="after")
    def _divisible(self) -> Normalize:
        if 0.0 in (self.std if isinstance(self.std, list) else [self.std]):
            raise ValueError("std is 0; give the divisor, e.g. 255 for bytes")
        return self


class Scale(CardModel):
    """value * scale + offset, float32."""

    wrapper: Literal["scale"]
    scale: float = 1.0
    """Factor of every number."""
    offset: float = 0.0
    """Added after scaling."""


class Clip(CardModel):
    """Limit every number; inf and -inf become the limits, NaN becomes `nan`."""

    wrapper: Literal["clip"]
    limits: Limits
    """Lowest and highest number."""
    nan: float | None = None
    """What NaN becomes; null = it stays."""


class Grayscale(CardModel):
    """One brightness in place of three colours (ITU-R 601): (H, W, 3) to (H, W)."""

    wrapper: Literal["grayscale"]


class Quantize(CardModel):
    """Round to multiples of a step, as a sensor with few bits does."""

    wrapper: Literal["quantize"]
    step: float = Field(default=1.0, gt=0.0)
    """In the unit of the sample."""


class Stack(CardModel):
    """The last samples together, oldest first; the first one stands for those before it."""

    wrapper: Literal["stack"]
    steps: int = Field(ge=2, le=100)
    """Number of samples."""
    axis: Literal["first", "last", "channel"] = "first"
    """`first`, `last`: a new axis there. `channel`: along the last axis, which grows."""


class Channels(CardModel):
    """Move colours first or last; an image without any gets `repeat` equal ones."""

    wrapper: Literal["channels"]
    axis: Literal["first", "last"] = "first"
    """Where the colours go."""
    repeat: int = Field(default=1, ge=1, le=16)
    """Number of equal colours of an image without any."""


class Flatten(CardModel):
    """All numbers in one row, as networks without convolutions take them."""

    wrapper: Literal["flatten"]


BuiltInWrapper = (
    NoiseWrap
    | Crop
    | Resize
    | Normalize
    | Scale
    | Clip
    | Grayscale
    | Quantize
    | Stack
    | Channels
    | Flatten
)
"""The table of built-in wrappers; `sensors.wrappers` has the function that makes each."""

BUILT_IN_WRAPPERS = names_of(BuiltInWrapper, "wrapper")


class PluginWrap(CardModel):
    """A wrapper of somebody else: an installed plug-in, or `module:Class`."""

    model_config = ConfigDict(extra="allow", frozen=True)

    wrapper: str
    """Name of an installed wrapper, or `module:Class`."""

    @model_validator(mode="after")
    def _known(self) -> PluginWrap:
        known_or_raise(self.wrapper, WRAPPERS, BUILT_IN_WRAPPERS)
        return self

    @property
    def parameters(self) -> dict[str, Any]:
        """Keyword arguments of its class."""
        return dict(self.model_extra or {})


def _bare_word(value: Any) -> Any:
    """Read `grayscale` as `{wrapper: grayscale}`."""
    return {"wrapper": value} if isinstance(value, str) else value


AnyWrapper = BuiltInWrapper | PluginWrap
Wrapper = Annotated[AnyWrapper, NamedBy("wrapper"), BeforeValidator(_bare_word)]
