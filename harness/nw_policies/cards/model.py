"""What every part of a policy card has in common."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from nw_base.clean import clean

CONTROL_RATE = 50
"""Control steps per second, Hz, of all policies whose rate divides it."""


class CardModel(BaseModel):
    """A frozen part of a card; a key that it does not know is an error, as are inf and NaN."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True
    )


def _line(text: str) -> str:
    return clean(text, at_most=300)


Line = Annotated[str, AfterValidator(_line)]
"""Words for people, on one line; no part of any digest."""


def _both_sides(value: Any) -> Any:
    """Read `clip: 4.8` as `[-4.8, 4.8]`."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if value <= 0:
            message = f"a limit of {value} leaves nothing; give a positive number or [low, high]"
            raise ValueError(message)
        return (-value, value)
    return value


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] >= value[1]:
        message = f"the limits [{value[0]:g}, {value[1]:g}] are empty; put the lower one first"
        raise ValueError(message)
    return value


Limits = Annotated[tuple[float, float], BeforeValidator(_both_sides), AfterValidator(_ordered)]
"""`[low, high]`, or one number for both sides of zero."""


def _whole(rate: Any) -> Any:
    """Read 50.0 as 50, so that both are the same card."""
    return int(rate) if isinstance(rate, float) and rate.is_integer() else rate


Rate = Annotated[int | float, BeforeValidator(_whole), Field(ge=1, le=2000)]
"""Samples or actions per second, Hz."""

Latency = Annotated[float, Field(ge=0.0, le=2.0)]
"""Age of a measurement when the policy first sees it, s, in whole control steps."""


def is_whole(number: float) -> bool:
    """Return whether a number is a whole one, rounding of decimals aside."""
    return abs(number - round(number)) < 1e-3 * max(number, 1e-3)
