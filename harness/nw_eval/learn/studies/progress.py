"""One line before each stage of a study: what comes, how much there is, how long it may take."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence

_MINUTE = 60.0


class StudyProgress:
    """Says which stage begins. What is left is reckoned with how long stages of its kind took here.

    Args:
        say: takes a line.
        kinds: of all stages in their order, such as `trains`.
        done: stages that an earlier process has done.
        clock: seconds, never going back.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        kinds: Sequence[str],
        *,
        done: Sequence[int] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._say, self._kinds, self._clock = say, kinds, clock
        self._left = [place for place in range(len(kinds)) if place not in set(done)]
        self._took: dict[str, list[float]] = {}
        self._began = self._stage_began = clock()

    def begin(self, place: int, doing: str) -> None:
        """Say that a stage begins."""
        self._stage_began = self._clock()
        words = [f"study: {place + 1} of {len(self._kinds)}", doing]
        if self._took:
            words.append(f"{_minutes(self._stage_began - self._began)} so far")
        left = self._seconds_left()
        if left is not None:
            words.append(f"about {_minutes(left)} left")
        self._say(" · ".join(words))

    def end(self, place: int) -> None:
        """Take it that a stage has ended."""
        self._took.setdefault(self._kinds[place], []).append(self._clock() - self._stage_began)
        self._left.remove(place)

    def _seconds_left(self) -> float | None:
        """Return what is left; None while a kind of stage is left that none has been done of."""
        kinds = Counter(self._kinds[place] for place in self._left)
        if not kinds or not set(kinds) <= set(self._took):
            return None
        return sum(
            count * sum(self._took[kind]) / len(self._took[kind]) for kind, count in kinds.items()
        )


def _minutes(seconds: float) -> str:
    if seconds < _MINUTE:
        return f"{seconds:.0f} s"
    minutes = seconds / _MINUTE
    return f"{minutes:.0f} min" if minutes < 120.0 else f"{minutes / 60.0:.1f} h"
