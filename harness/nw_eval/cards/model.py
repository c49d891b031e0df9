"""What every part of a policy card has in common."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from nw_eval.clean import clean

CONTROL_RATE = 50
"""Control steps per second of every protocol, Hz."""


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


def _divides(rate: int) -> int:
    if CONTROL_RATE % rate:
        known = ", ".join(str(r) for r in range(1, CONTROL_RATE + 1) if CONTROL_RATE % r == 0)
        message = f"a rate of {rate} Hz does not divide the control rate of {CONTROL_RATE} Hz"
        raise ValueError(f"{message}; use one of {known}")
    return rate


Rate = Annotated[int, Field(ge=1, le=CONTROL_RATE), AfterValidator(_divides)]
"""Samples per second, Hz, with a whole number of control steps between two of them."""


def _whole_steps(latency: float) -> float:
    steps = latency * CONTROL_RATE
    if abs(steps - round(steps)) > 1e-6:
        message = f"a latency of {latency:g} s is not a whole number of control steps"
        raise ValueError(f"{message}; use a multiple of {1 / CONTROL_RATE:g}")
    return latency


Latency = Annotated[float, Field(ge=0.0, le=2.0), AfterValidator(_whole_steps)]
"""Age of a measurement when the policy first sees it, s, in whole control steps."""
