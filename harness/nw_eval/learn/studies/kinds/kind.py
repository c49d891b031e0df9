"""What a kind of study is asked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from nw_eval.learn.studies.config import StudyConfig
    from nw_eval.learn.studies.plan import PlannedStudent
    from nw_eval.learn.studies.scores import Outcome, Score
    from nw_eval.reporting.tables import Table


class Kind(Protocol):
    """A kind of study; modules of this room are."""

    @property
    def config(self) -> type[StudyConfig]:
        """The model of its configs."""
        ...

    def students(self, config: Any, /) -> tuple[PlannedStudent, ...]:
        """Return whom it trains.

        Raises:
            SceneError, UsageError: scenes cannot be used.
        """
        ...

    def scores(
        self, students: Sequence[PlannedStudent], outcomes: Sequence[Outcome], /
    ) -> list[Score]:
        """Return the numbers of its figure, as far as there are outcomes."""
        ...

    def tables(
        self, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> tuple[Table, ...]:
        """Return the same as tables."""
        ...

    def draw(
        self, path: Path, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> None:
        """Draw the figure.

        Raises:
            StoreError: it cannot be written.
        """
        ...
