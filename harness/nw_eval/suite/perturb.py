"""The grid of perturbations that a suite asks for, and the axis that a sweep goes along.

An axis of a sweep is written `friction=0.3..1.2`, `payload=0..6:4`, `push=0,0.5,1`. What axes there
are: `suite.axes`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Self, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    create_model,
    model_validator,
)
from pydantic_core import InitErrorDetails

from nw_eval.errors import PluginError, UsageError, nearest
from nw_eval.plugins import AXES as GROUP
from nw_eval.plugins import distribution, installed, is_elsewhere, warn_if_built_in
from nw_eval.plural import plural
from nw_eval.suite.axes import AXES, Axis, axis_named, axis_names, is_axis

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails


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
            wrong = [*map(_again, error.errors()), *wrong]
        else:
            if not wrong:
                return grid
        raise ValidationError.from_exception_data(cls.__name__, wrong)

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
        cells: list[tuple[tuple[str, float], ...]] = [()]
        for axis, values in sorted(self.axes.items()):
            cells = [(*cell, (axis, float(value))) for cell in cells for value in values]
        return tuple(cells)


def _faults_of(name: Any, values: Any, *, is_saved: bool) -> Iterator[InitErrorDetails]:
    """Yield what is wrong with an axis that is not built in.

    Args:
        name: as the suite has it.
        values: as above.
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
            yield _again({**detail, "loc": (name, *detail["loc"])})


def _adapter(axis: Axis) -> TypeAdapter[Any]:
    return TypeAdapter(_values_of(axis.value_type), config=_NUMBERS)


def _again(detail: ErrorDetails) -> InitErrorDetails:
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
    def of(cls, words: str) -> SweptAxis:
        """Return the axis that words such as `friction=0.3..1.2:7` name.

        Values of an axis that has a `step`, such as latencies, are taken to the nearest one.

        Raises:
            UsageError: there is no such axis, or its values cannot be used.
            PluginError: the package of the axis is broken.
        """
        name, equals, span = words.partition("=")
        if not is_axis(name):
            fix = nearest(name, axis_names())
            raise UsageError(f"--axis {words!r}: there is no axis {name!r}", fix=fix)
        axis = axis_named(name)
        found = _RANGE.fullmatch(span)
        if found is not None:
            values = _between(float(found[1]), float(found[2]), int(found[3] or STEPS), words)
        elif equals and _LIST.fullmatch(span):
            values = [float(value) for value in span.split(",")]
        else:
            raise UsageError(
                f"--axis {words!r}: {span!r} is no range of values",
                fix=f"write {name}=FROM..TO, {name}=FROM..TO:STEPS or {name}=VALUE,VALUE",
            )
        if axis.step is not None:
            values = [round(axis.nearest_step(value), _DIGITS) for value in values]
        kept = tuple(sorted(set(values)))
        if len(kept) < 2:
            raise UsageError(f"--axis {words!r} has one value", fix="give two or more")
        try:
            Perturb.model_validate({name: kept})
        except ValidationError as error:
            first = error.errors()[0]
            value = first.get("input")
            raise UsageError(
                f"--axis {words!r}: {value!r}: {first['msg'].lower()}",
                fix=f"give {axis.low:g} to {axis.high:g}",
            ) from None
        return cls(name=name, values=kept)


def _between(low: float, high: float, steps: int, words: str) -> list[float]:
    if not 2 <= steps <= MOST_STEPS:
        raise UsageError(
            f"--axis {words!r} has {plural(steps, 'step')}", fix=f"give 2 to {MOST_STEPS}"
        )
    gap = (high - low) / (steps - 1)
    return [round(low + gap * step, _DIGITS) for step in range(steps)]
