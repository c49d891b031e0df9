"""What one log shows, as a process that read it hands it over."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

_Metres = Annotated[float, Field(ge=-1e6, le=1e6)]
Point = tuple[_Metres, _Metres]
"""x and y in the world frame, m."""

_MOST_POINTS = 20_000
"""Of a path: half an hour at 10 Hz."""
_LONGEST = 300
"""Characters of a text."""


class _Read(BaseModel):
    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        ser_json_bytes="base64",
        val_json_bytes="base64",
    )


class ReadPlace(_Read):
    """The place of a trial from straight above."""

    box: tuple[_Metres, _Metres, _Metres, _Metres]
    """West, south, east, north."""
    picture: bytes
    """A WebP of what lies in the box."""


class ReadClip(_Read):
    """The last seconds of what a camera saw."""

    data: bytes
    """An animated WebP."""
    still: bytes
    """Its last picture, a WebP."""
    width: int = Field(gt=0)
    height: int = Field(gt=0)
    topic: str = Field(max_length=_LONGEST)
    seconds: float = Field(ge=0.0)


class ReadLog(_Read):
    """All of it."""

    fault: str = Field(default="", max_length=_LONGEST)
    """Why it cannot be read; empty if it can, and then there are a path and waypoints."""
    walked: tuple[Point, ...] = Field(default=(), max_length=_MOST_POINTS)
    waypoints: tuple[Point, ...] = Field(default=(), max_length=1000)
    reach: float | None = None
    """Metres from a waypoint at which it counts as reached."""
    place: ReadPlace | None = None
    clip: ReadClip | None = None
    unseen: str = Field(default="", max_length=_LONGEST)
    """Why its pictures cannot be shown; empty if they are, are not wanted, or there are none."""

    @model_validator(mode="after")
    def _shows_something(self) -> Self:
        if not self.fault and not (self.walked and self.waypoints):
            raise ValueError("neither a fault nor a path")
        return self


class ReadLogs(_Read):
    """Several, in the order in which they were wanted."""

    logs: tuple[ReadLog, ...]
