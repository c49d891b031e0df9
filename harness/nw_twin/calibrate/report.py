"""Progress lines of a calibration, and its report."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from nw_base.files.cache import atomic_path

Say = Callable[[str], None]

_EVERY = 5.0
"""Seconds between two lines."""


@dataclass
class Pace:
    """Says now and then how much is done.

    Attributes:
        say: is given each line.
        what: is done, e.g. `features of photographs`.
        total: pieces of it; 0 where they cannot be counted.
        clock: seconds, from any beginning.
        begun_at: pieces that were done before, in unknown time.
    """

    say: Say
    what: str
    total: int
    clock: Callable[[], float] = time.monotonic
    begun_at: int = 0
    _begin: float = field(init=False)
    _last: float = field(init=False)

    def __post_init__(self) -> None:
        """Begin to count."""
        self._begin = self._last = self.clock()

    def at(self, done: int) -> None:
        """Say that so many are done, if the last line is some seconds old, or all are."""
        now = self.clock()
        spent = now - self._begin
        if done >= self.total:
            self.say(f"{self.what}: {self.total} in {_duration(spent)}")
        elif done > self.begun_at and now - self._last >= _EVERY:
            left = spent / (done - self.begun_at) * (self.total - done)
            self.say(f"{self.what}: {done} of {self.total}, about {_duration(left)} left")
            self._last = now

    def goes_on(self) -> None:
        """Print the time that is left, if the last line is some seconds old."""
        now = self.clock()
        if now - self._last >= _EVERY:
            self.say(f"{self.what}: {_duration(now - self._begin)} so far")
            self._last = now


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min"


REPORT = "report.json"
_NAMED = 6
"""Photographs that a line names; the report has all."""


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """A photograph that the capture lacks.

    Attributes:
        name: of the photograph.
        reason: in a few words that several may share, e.g. `blurred`.
        detail: the number behind it.
    """

    name: str
    reason: str
    detail: str


@dataclass(frozen=True, kw_only=True)
class CalibrationReport:
    """Report of a calibration: its input, its steps and its results.

    Attributes:
        source: what was read: the kind of Footage.
        photographs: that there were, the unreadable counted.
        placed: those whose cameras are known.
        left_out: the others, and why.
        matching: which were compared: `sequential`, `retrieval`, `exhaustive`, or `none` where
            points are known.
        pairs: of photographs that were compared.
        mapping: what placed the cameras: `incremental`, `global`, or `known`.
        tries: photographs that each mapping placed.
        lenses: each camera model with its numbers, as COLMAP writes them.
        points: in the capture.
        reprojection_error: mean over points, pixels of the photographs; None without points.
        masked: pictures with a mask.
        groups: photographs of each other group that was placed among itself, with nothing that ties
            it to the largest; they count as left out.
        seed: of whatever was random.
        written: whether the capture was written.
    """

    source: str
    photographs: int
    placed: int
    left_out: tuple[LeftOut, ...]
    matching: str
    pairs: int
    mapping: str
    tries: dict[str, int]
    lenses: tuple[str, ...] = ()
    points: int = 0
    reprojection_error: float | None = None
    masked: int = 0
    groups: tuple[int, ...] = ()
    seed: int = 0
    written: bool = False

    @property
    def share(self) -> float:
        """Share of the photographs whose cameras are known."""
        return self.placed / max(1, self.photographs)

    def write(self, folder: Path) -> None:
        """Write report.json.

        Raises:
            StoreError: it cannot be written.
        """
        with atomic_path(folder / REPORT) as temporary:
            text = json.dumps({"nw-calibration": 1, **asdict(self)}, indent=1, ensure_ascii=False)
            temporary.write_text(text + "\n", encoding="utf-8", errors="backslashreplace")


def by_reason(left_out: tuple[LeftOut, ...]) -> list[str]:
    """Return a line for each reason, with the first photographs that it applies to."""
    reasons = dict.fromkeys(one.reason for one in left_out)
    return [_line(reason, [one for one in left_out if one.reason == reason]) for reason in reasons]


def _line(reason: str, mine: list[LeftOut]) -> str:
    details = {one.detail for one in mine}
    shared = details.pop() if len(details) == 1 and len(mine) > 1 else None
    named = [one.name if shared else f"{one.name} ({one.detail})" for one in mine[:_NAMED]]
    more = f" and {len(mine) - _NAMED} more" if len(mine) > _NAMED else ""
    return f"{reason}: {', '.join(named)}{more}" + (f" ({shared})" if shared else "")
