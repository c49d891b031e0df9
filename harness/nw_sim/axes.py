"""The axes of perturbation: what a suite may change about robot, scene and senses.

Each axis is one value. Whatever speaks of axes (suite, sweep, report, browser) goes by these
values, those of installed packages among them (entry-point group `nw_eval.axes`).

Of them are the grid that a suite asks for, and the axis that a sweep goes along. An axis of a sweep
is written `friction=0.3..1.2`, `payload=0..6:4`, `push=0,0.5,1`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    SerializerFunctionWrapHandler,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    create_model,
    model_serializer,
    model_validator,
)
from pydantic_core import InitErrorDetails

from nw_base.errors import PluginError, UsageError, nearest
from nw_base.files.yaml_file import explain_limit
from nw_base.plugins import AXES as GROUP
from nw_base.plugins import distribution, installed, is_elsewhere, load, warn, warn_if_built_in
from nw_base.plural import plural
from nw_base.trials import cells_of

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

CONTROL_STEP = 0.02
"""Seconds between two looks at the robot, which latencies are whole numbers of."""

Felt = Literal["always", "camera", "splat_rgb", "cones", "command"]
"""What must be there for an axis to change anything: nothing, a camera of the policy, a colour
camera, a camera that shows the cones of the course, or a velocity command of the suite's task."""


@dataclass(frozen=True, kw_only=True)
class Axis:
    """An axis of perturbation.

    Attributes:
        name: its key in `perturb` of a suite, in `--axis` and in rows.
        description: what it is, with its unit; a sentence.
        neutral: the value that changes no bit; None where there is none.
        change: gets the `TrialSetup` of a trial and the axis's value, and returns another setup. It
            is called where the value is not `neutral`, before the trial begins, and must depend on
            its arguments alone; random numbers come from `TrialSetup.generator`.
        low: least value.
        high: greatest value.
        above_low: whether `low` itself is excluded.
        unit: of the values; empty for plain numbers.
        step: of which values are whole numbers; None = any number.
        steps: what those are called in messages.
        nominal: default value when the axis has no neutral one (`neutral` is None).
        slider: least value, greatest value and step of the slider in `nw-eval view`; `low`, `high`
            and a hundredth of their distance if None.
        felt_by: what policy or task must have for it to change anything.

    Raises:
        ValueError: the figures do not fit one another.
    """

    name: str
    description: str
    neutral: float | None
    change: Callable[[Any, float], Any]
    low: float
    high: float
    above_low: bool = False
    unit: str = ""
    step: float | None = None
    steps: str = "steps"
    nominal: float | None = None
    slider: tuple[float, float, float] | None = None
    felt_by: Felt = "always"

    def __post_init__(self) -> None:
        if not (self.name.isascii() and self.name.isidentifier()):
            raise ValueError(f"axis {self.name!r}: a name has letters, digits and '_' only")
        if self.neutral is None and self.nominal is None:
            raise ValueError(f"axis {self.name!r} has neither `neutral` nor `nominal`")
        least, most, step = self.slides
        if not (self.low <= least <= self.reference <= most <= self.high and step > 0.0):
            raise ValueError(
                f"axis {self.name!r}: low {self.low:g}, slider {least:g} to {most:g} in steps of "
                f"{step:g}, neutral {self.reference:g} and high {self.high:g} do not fit"
            )

    @property
    def reference(self) -> float:
        """The value that others are compared with: the neutral one, or `nominal`."""
        value = self.nominal if self.neutral is None else self.neutral
        assert value is not None, "an axis has one of the two"
        return value

    @property
    def label(self) -> str:
        """Its name with its unit: `payload, kg`."""
        return f"{self.name}, {self.unit}" if self.unit else self.name

    @property
    def slides(self) -> tuple[float, float, float]:
        """Least value, greatest value and step of its slider."""
        least, most = self.low, self.high
        return self.slider or (least, most, self.step or (most - least) / 100.0)

    @property
    def value_type(self) -> Any:
        """What pydantic checks one of its values by."""
        bounds = Field(
            gt=self.low if self.above_low else None,
            ge=None if self.above_low else self.low,
            le=self.high,
        )
        return Annotated[float, bounds, AfterValidator(self._whole)]

    def nearest_step(self, value: float) -> float:
        """Return a value, or the whole number of `step` that is nearest to it."""
        if self.step is None or not math.isfinite(value):
            return value
        return round(value / self.step) * self.step

    def _whole(self, value: float) -> float:
        count = 0.0 if self.step is None else value / self.step
        if abs(count - round(count)) <= 1e-6:
            return value
        unit = f" {self.unit}" if self.unit else ""
        size = f"{self.step:g}{unit}"
        raise ValueError(f"{value:g}{unit} is not a whole number of {self.steps} of {size}")


_ALL = (
    Axis(
        name="friction",
        description="Sliding friction of all ground and obstacles (1.25 as built). It replaces the "
        "foot's own friction, too.",
        neutral=None,  # Each solid has its own.
        nominal=1.25,
        low=0.0,
        above_low=True,
        high=5.0,
        slider=(0.05, 1.5, 0.05),
        change=lambda setup, value: setup.replaced(friction=value),
    ),
    Axis(
        name="payload",
        description="Load on the robot's back, kg.",
        unit="kg",
        neutral=0.0,
        low=0.0,
        high=20.0,
        slider=(0.0, 10.0, 0.25),
        change=lambda setup, value: setup.replaced(payload=value),
    ),
    Axis(
        name="push",
        description="Speed that the trunk is given, level, in a drawn direction, m/s: first "
        "after 1 to 3 s, then every 3 s.",
        unit="m/s",
        neutral=0.0,
        low=0.0,
        high=3.0,
        slider=(0.0, 2.0, 0.1),
        change=lambda setup, value: setup.replaced(push=value),
    ),
    Axis(
        name="strength",
        description="Factor of the motors' gain and of their largest torque; damping stays.",
        neutral=1.0,
        low=0.0,
        above_low=True,
        high=2.0,
        slider=(0.3, 1.5, 0.05),
        change=lambda setup, value: setup.with_strength(value),
    ),
    Axis(
        name="latency",
        description="Age added to every observation, s, in control steps of 0.02 s; at rates that "
        "do not divide 50 Hz the next whole control step.",
        unit="s",
        neutral=0.0,
        low=0.0,
        high=1.0,
        step=CONTROL_STEP,
        steps="control steps",
        slider=(0.0, 0.2, CONTROL_STEP),
        change=lambda setup, value: setup.later(value),
    ),
    Axis(
        name="noise",
        description="Standard deviation of errors of every number observed: of the body as the "
        "policy is fed, of heights and depths in m, of colours as a share of white. The card's own "
        "noise is added.",
        neutral=0.0,
        low=0.0,
        high=10.0,
        slider=(0.0, 0.5, 0.01),
        change=lambda setup, value: setup.with_noise(value),
    ),
    Axis(
        name="exposure",
        description="Brightness of camera images, as a factor.",
        neutral=1.0,
        low=0.0,
        above_low=True,
        high=4.0,
        slider=(0.1, 3.0, 0.1),
        felt_by="splat_rgb",
        change=lambda setup, value: setup.with_air(exposure=value),
    ),
    Axis(
        name="fog",
        description="Share of its light that a camera image loses per metre, as exponent, 1/m; 0.5 "
        "leaves 37 % at 2 m.",
        unit="1/m",
        neutral=0.0,
        low=0.0,
        high=5.0,
        slider=(0.0, 1.0, 0.05),
        felt_by="splat_rgb",
        change=lambda setup, value: setup.with_air(fog=value),
    ),
    Axis(
        name="camera_pitch",
        description="Angle by which cameras pitch farther down, rad.",
        unit="rad",
        neutral=0.0,
        low=-0.8,
        high=0.8,
        slider=(-0.5, 0.5, 0.01),
        felt_by="camera",
        change=lambda setup, value: setup.remounted(pitch=value),
    ),
    Axis(
        name="camera_height",
        description="Length by which cameras sit higher on the trunk, m.",
        unit="m",
        neutral=0.0,
        low=-0.3,
        high=0.3,
        slider=(-0.2, 0.2, 0.01),
        felt_by="camera",
        change=lambda setup, value: setup.remounted(height=value),
    ),
    Axis(
        name="field_of_view",
        description="Vertical field of view of cameras, as a factor.",
        neutral=1.0,
        low=0.3,
        high=1.5,
        slider=(0.5, 1.5, 0.05),
        felt_by="camera",
        change=lambda setup, value: setup.remounted(factor=value),
    ),
    Axis(
        name="missing_cones",
        description="Probability that images omit a waypoint's cone; drawn for each trial.",
        neutral=0.0,
        low=0.0,
        high=1.0,
        slider=(0.0, 1.0, 0.1),
        felt_by="cones",
        change=lambda setup, value: setup.replaced(missing_cones=value),
    ),
    Axis(
        name="speed",
        description="Commanded speed forwards, m/s, at all times, in place of the command of the "
        "suite's task.",
        unit="m/s",
        neutral=None,  # The suite's own command.
        nominal=0.0,
        low=-5.0,
        high=5.0,
        slider=(0.0, 2.0, 0.05),
        felt_by="command",
        change=lambda setup, value: setup.commanding(vx=value),
    ),
    Axis(
        name="turn_rate",
        description="Commanded turn rate to the left, rad/s, at all times, in place of the command "
        "of the suite's task.",
        unit="rad/s",
        neutral=None,
        nominal=0.0,
        low=-5.0,
        high=5.0,
        slider=(-2.0, 2.0, 0.05),
        felt_by="command",
        change=lambda setup, value: setup.commanding(yaw=value),
    ),
)

AXES = MappingProxyType({axis.name: axis for axis in _ALL})
"""Those that are built in, by name."""
COMMANDED = MappingProxyType({"speed": "vx", "turn_rate": "yaw"})
"""Those that replace a part of the commanded velocity, and which."""


def axis_names() -> tuple[str, ...]:
    """Return the names of all axes: the built-in ones, then those of packages, not imported."""
    return (*AXES, *(name for name in installed(GROUP) if name not in AXES))


def is_axis(name: str) -> bool:
    """Whether an axis of that name is built in or installed."""
    return name in AXES or name in installed(GROUP)


def usable_axes() -> dict[str, Axis]:
    """Return all axes that can be used, by name; one whose package is broken is warned of."""
    axes = dict(AXES)
    for name in axis_names():
        try:
            axes[name] = axis_named(name)
        except PluginError as error:
            warn(str(error))
    return axes


def axis_named(name: str) -> Axis:
    """Return an axis; the package of one that is not built in is imported.

    Raises:
        UsageError: there is no such axis.
        PluginError: its package is broken.
    """
    if name in AXES:
        return AXES[name]
    if not is_axis(name):
        raise UsageError(f"there is no axis {name!r}", fix=nearest(name, axis_names()))
    return load(GROUP, name, Axis)


def each_once(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """Refuse a value that is given twice."""
    for index, value in enumerate(values):
        if value in values[:index]:
            raise ValueError(f"{value!r} is given twice; remove one")
    return values


def _values_of(value_type: Any) -> Any:
    return Annotated[tuple[value_type, ...], AfterValidator(each_once)]


_NUMBERS = ConfigDict(strict=True, allow_inf_nan=False)
_SAVED = TypeAdapter[Any](_values_of(float), config=_NUMBERS)


def _with_installed(schema: dict[str, Any]) -> None:
    """Add the axes of installed packages to the JSON Schema; none of them is imported."""
    schema["additionalProperties"] = False
    for name, points in installed(GROUP).items():
        if name not in AXES:
            schema["properties"][name] = {
                "type": "array",
                "items": {"type": "number"},
                "description": f"An axis of the package {distribution(points[0])}.",
            }


class _Grid(BaseModel):
    """Axes of the perturbation grid. An axis that is left out is not touched.

    A trial runs once in every cell of the grid, and the cell is part of the trial's identity.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="allow",  # Axes of packages; others are refused below.
        strict=True,
        allow_inf_nan=False,
        json_schema_extra=_with_installed,
    )

    @model_validator(mode="wrap")
    @classmethod
    def _known(
        cls, value: Any, read: ModelWrapValidatorHandler[Self], info: ValidationInfo
    ) -> Self:
        """Check the axes that are no fields, too: all that is wrong is told at once."""
        if not isinstance(value, Mapping):
            return read(value)
        settings = cast("Mapping[Any, Any]", value)
        named = (info.context or {}).get("plugins", {})
        wrong: list[InitErrorDetails] = []
        for name, values in settings.items():
            if name not in cls.model_fields:
                is_saved = is_elsewhere(GROUP, str(name), named)
                wrong += _faults_of(name, values, is_saved=is_saved)
            elif values:
                warn_if_built_in(GROUP, name)
        try:
            grid = read(value)
        except ValidationError as error:
            wrong = [*map(_as_init_error, error.errors()), *wrong]
        else:
            if not wrong:
                return grid
        raise ValidationError.from_exception_data(cls.__name__, wrong)

    @model_serializer(mode="wrap")
    def _without_commands(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # A suite without them keeps the digest that it had before there were such axes.
        return {
            axis: values for axis, values in write(self).items() if values or axis not in COMMANDED
        }

    @classmethod
    def other_keys(cls) -> set[str]:
        """Return the keys that are no fields: axes of packages."""
        return set(axis_names())

    @property
    def axes(self) -> dict[str, tuple[float, ...]]:
        """The values of each axis that has some."""
        return {axis: values for axis, values in self.model_dump().items() if values}

    @property
    def cells(self) -> tuple[tuple[tuple[str, float], ...], ...]:
        """The cells of the grid, axes in alphabetical order; one empty cell without axes."""
        return cells_of(self.axes)


def _faults_of(name: Any, values: Any, *, is_saved: bool) -> Iterator[InitErrorDetails]:
    """Yield what is wrong with an axis that is not built in.

    Args:
        name: of the axis, as the suite has it.
        values: of the axis, as the suite has them.
        is_saved: whether its package is installed elsewhere only: any numbers are fine then.
    """
    if not is_saved and not (isinstance(name, str) and is_axis(name)):
        yield InitErrorDetails(type="extra_forbidden", loc=(name,), input=values)
        return
    try:
        adapter = _SAVED if is_saved else _adapter(axis_named(name))
        adapter.validate_python(values)
    except PluginError as error:
        yield InitErrorDetails(
            type="value_error", loc=(name,), input=values, ctx={"error": ValueError(str(error))}
        )
    except ValidationError as error:
        for detail in error.errors():
            yield _as_init_error({**detail, "loc": (name, *detail["loc"])})


def _adapter(axis: Axis) -> TypeAdapter[Any]:
    return TypeAdapter(_values_of(axis.value_type), config=_NUMBERS)


def _as_init_error(detail: ErrorDetails) -> InitErrorDetails:
    """Return an error of pydantic's as it takes it."""
    return InitErrorDetails(
        type=detail["type"],
        loc=detail["loc"],
        input=detail["input"],
        ctx=detail.get("ctx", {}),
    )


if TYPE_CHECKING:

    class Perturb(_Grid):
        """The grid with a field for each axis that is built in."""

else:
    Perturb = create_model(
        "Perturb",
        __base__=_Grid,
        __module__=__name__,
        __doc__=_Grid.__doc__,
        **{
            axis.name: (_values_of(axis.value_type), Field((), description=axis.description))
            for axis in AXES.values()
        },
    )


STEPS = 7
"""Values from one end to the other, both counted, where nothing else is said."""
MOST_STEPS = 100
_DIGITS = 4
_NUMBER = r"-?(?:\d+\.?\d*|\.\d+)(?:e-?\d+)?"
_RANGE = re.compile(rf"({_NUMBER})\.\.({_NUMBER})(?::(\d{{1,6}}))?")
_LIST = re.compile(rf"{_NUMBER}(?:,{_NUMBER})*")


@dataclass(frozen=True, kw_only=True)
class SweptAxis:
    """An axis and its values, ascending."""

    name: str
    values: tuple[float, ...]

    @classmethod
    def of(cls, text: str) -> SweptAxis:
        """Return the axis that words such as `friction=0.3..1.2:7` name.

        Values of an axis that has a `step`, such as latencies, are taken to the nearest one.

        Raises:
            UsageError: there is no such axis, or its values cannot be used.
            PluginError: the package of the axis is broken.
        """
        name, equals, span = text.partition("=")
        if not is_axis(name):
            fix = nearest(name, axis_names())
            raise UsageError(f"--axis {text!r}: there is no axis {name!r}", fix=fix)
        axis = axis_named(name)
        match = _RANGE.fullmatch(span)
        if match is not None:
            values = _between(float(match[1]), float(match[2]), int(match[3] or STEPS), text)
        elif equals and _LIST.fullmatch(span):
            values = [float(value) for value in span.split(",")]
        else:
            raise UsageError(
                f"--axis {text!r}: {span!r} is not a range of values",
                fix=f"write {name}=FROM..TO, {name}=FROM..TO:STEPS or {name}=VALUE,VALUE",
            )
        if axis.step is not None:
            values = [round(axis.nearest_step(value), _DIGITS) for value in values]
        kept = tuple(sorted(set(values)))
        if len(kept) < 2:
            raise UsageError(f"--axis {text!r} has one value", fix="give two or more")
        try:
            Perturb.model_validate({name: kept})
        except ValidationError as error:
            first = error.errors()[0]
            why = explain_limit(first) or first["msg"].lower()
            raise UsageError(
                f"--axis {text!r}: {first.get('input')!r}: {why}",
                fix=f"give {axis.low:g} to {axis.high:g}",
            ) from None
        return cls(name=name, values=kept)


def _between(low: float, high: float, steps: int, text: str) -> list[float]:
    if not 2 <= steps <= MOST_STEPS:
        raise UsageError(
            f"--axis {text!r} has {plural(steps, 'step')}", fix=f"give 2 to {MOST_STEPS}"
        )
    gap = (high - low) / (steps - 1)
    return [round(low + gap * step, _DIGITS) for step in range(steps)]
