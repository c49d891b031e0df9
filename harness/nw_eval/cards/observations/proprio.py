"""Numbers of the body, and the frames before the present one."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from nw_eval.cards.layouts import LAYOUTS, LayoutName
from nw_eval.cards.model import CardModel, Limits
from nw_eval.cards.observations.base import BaseObservation
from nw_eval.cards.terms import AnyTerm, Term

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
            message = f"select: {entry!r} is no index or range; write 7 or 13:53"
            raise ValueError(message) from None
        if not 0 <= start < stop <= size:
            message = f"select: {entry!r} is outside the {size} numbers of the {of}"
            raise ValueError(f"{message}; counts start at 0, ends are excluded")
        indices.extend(range(start, stop))
    return indices
