"""What a calibration found, for whoever reads it, person or program."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from nw_eval.files.cache import atomic_path

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
    """What a calibration read, did and found.

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
    """Return a line for each reason, with the first photographs that it holds for."""
    reasons = dict.fromkeys(one.reason for one in left_out)
    return [_line(reason, [one for one in left_out if one.reason == reason]) for reason in reasons]


def _line(reason: str, mine: list[LeftOut]) -> str:
    details = {one.detail for one in mine}
    shared = details.pop() if len(details) == 1 and len(mine) > 1 else None
    named = [one.name if shared else f"{one.name} ({one.detail})" for one in mine[:_NAMED]]
    more = f" and {len(mine) - _NAMED} more" if len(mine) > _NAMED else ""
    return f"{reason}: {', '.join(named)}{more}" + (f" ({shared})" if shared else "")
