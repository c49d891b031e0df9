"""One trial's result: what a run is made of, and all that gate and report read."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, fields
from hashlib import sha256
from types import NoneType
from typing import Any, Literal, get_args

from nw_eval.clean import LONGEST, clean
from nw_eval.words import FAULTS, OUTCOMES, Fault, Outcome

Arm = Literal["candidate", "baseline"]
Status = Literal["ok", "error"]

MEASURED = frozenset(
    {
        "attempt",
        "cached",
        "host",
        "log_s",
        "mcap_bytes",
        "mcap_path",
        "physics_s",
        "policy_s",
        "render_s",
        "sense_s",
        "setup_s",
        "wall_s",
    }
)
"""Columns that may differ between two runs of the same trial; digests leave them out."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """The result of one trial. Times in s, digests hex sha256.

    `fraction` is the share of the trail's waypoints reached; None for a trial that did not run to
    a result, so that nobody averages it in. Every `*_s` but `sim_s` and `contact_s` is wall time of
    that stage; `wall_s` is all of the trial, stages not named here included.

    Texts may be a policy's or a file's: every one is made harmless and short (`clean.clean`).

    Raises:
        ValueError: a value is of the wrong type, too large, or contradicts another one.
    """

    trial_id: str
    suite: str
    scene: str
    task: str
    seed_index: int
    seed: int  # Unsigned, 64 bits.
    policy: str
    arm: Arm = "candidate"
    attempt: int = 1
    perturbation: tuple[tuple[str, float], ...] = ()
    status: Status
    outcome: Outcome | Fault
    end_reason: str
    """What the outcome was decided by: "roll", "contact face", "time"; where the policy itself
    failed, one of `words.POLICY_FAULTS`."""
    completed: bool
    fraction: float | None
    waypoints_reached: int
    waypoints_total: int
    waypoint_times: tuple[float, ...] = ()  # Single precision, as the file keeps them.
    steps: int
    sim_s: float
    physics_s: float
    render_s: float
    policy_s: float
    log_s: float
    wall_s: float
    coverage_min: float | None = None  # Of the camera frames' splat alpha; None without frames.
    coverage_mean: float | None = None
    state_digest: str = ""
    action_digest: str = ""
    checkpoint_digest: str
    scene_digest: str
    cached: bool = False
    host: str = ""
    mcap_path: str = ""  # Relative to the run folder; empty without a log.
    mcap_bytes: int = 0
    error_type: str = ""
    error_text: str = ""
    contact_s: float = 0.0  # Simulated time during which head or trunk collided.
    setup_s: float = 0.0  # Scene, world and policy, before the first step.
    sense_s: float = 0.0  # Observations that are no images.

    def __post_init__(self) -> None:
        fault = _mistyped(self)
        if fault is None:
            for name in _TEXTS:
                object.__setattr__(self, name, _harmless(getattr(self, name)))
            times = tuple(struct.unpack("f", struct.pack("f", t))[0] for t in self.waypoint_times)
            object.__setattr__(self, "waypoint_times", times)
            fault = _fault(self) or _boundless(self)
        if fault is not None:
            raise ValueError(f"row of trial {clean(self.trial_id, at_most=100)!r}: {fault}")

    @property
    def digest(self) -> str:
        """Hex sha256 of the result: all columns but the measured ones.

        What a policy said as it failed is no part of it: that may name a process, a path or the
        time. How it failed, where and after which actions, is.
        """
        kept = {name: value for name, value in to_dict(self).items() if name not in MEASURED}
        if self.outcome == "policy_failed":
            kept["error_text"] = ""
        text = json.dumps(kept, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return sha256(text.encode()).hexdigest()


_KINDS: dict[str, type | tuple[type, ...]] = {
    "str": str,
    "int": int,
    "bool": bool,
    "float": (float, int),
    "float | None": (float, int, NoneType),
}
_TYPES = {field.name: _KINDS.get(str(field.type)) or str for field in fields(Row)} | {
    "perturbation": tuple,
    "waypoint_times": tuple,
}
"""What a value may be, by column; the words of a Literal are texts."""

_TEXTS = tuple(name for name, kind in _TYPES.items() if kind is str)
_INTEGERS = tuple(name for name, kind in _TYPES.items() if kind is int)
_NUMBERS = tuple(name for name, kind in _TYPES.items() if kind not in {str, int, bool, tuple})
_WIDE = {"seed": 64, "mcap_bytes": 63}  # bits; all other integers have 31


def _mistyped(row: Row) -> str | None:
    """Return which column holds a value of the wrong type, or None."""
    for name, kind in _TYPES.items():
        value = getattr(row, name)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            return f"{name} is {clean(repr(value), at_most=60)}"
    return None


def _boundless(row: Row) -> str | None:
    """Return which number no file of rows can hold, or None."""
    for name in _INTEGERS:
        if not 0 <= getattr(row, name) < 2 ** _WIDE.get(name, 31):
            return f"{name} is {clean(getattr(row, name), at_most=30)}"
    numbers = [(name, getattr(row, name)) for name in _NUMBERS]
    numbers += [("waypoint_times", time) for time in row.waypoint_times]
    numbers += row.perturbation
    for name, number in numbers:
        if number is not None and not math.isfinite(number):
            return f"{clean(name, at_most=60)} is not finite"
    return None


def _harmless(text: str) -> str:
    """Return a text as `clean` leaves it; what it has left once stays, cut or not."""
    is_plain = text.isprintable() and not text.startswith("::") and "##[" not in text
    return text if is_plain and len(text) <= LONGEST + _LONGEST_MARK else clean(text)


_LONGEST_MARK = 60  # characters with which `clean` tells what it cut


def _fault(row: Row) -> str | None:
    """Return what contradicts itself in a row, or None."""
    if row.status not in get_args(Status):
        return f"status {row.status!r} is neither ok nor error"
    known = OUTCOMES if row.status == "ok" else FAULTS
    if row.outcome not in known:
        return f"outcome {row.outcome!r} does not go with status {row.status!r}"
    if not 0 <= row.waypoints_reached <= row.waypoints_total:
        return f"{row.waypoints_reached} of {row.waypoints_total} waypoints reached"
    if row.status == "error":
        return None if row.fraction is None else f"an error has a fraction ({row.fraction})"
    if row.fraction is None or not 0.0 <= row.fraction <= 1.0:
        return f"fraction {row.fraction} is not between 0 and 1"
    if row.completed != (row.fraction == 1.0):
        return f"completed is {row.completed} at fraction {row.fraction}"
    if not 0 <= row.seed < 2**64:
        return f"seed {row.seed} does not fit 64 bits"
    seconds = (getattr(row, field.name) for field in fields(Row) if field.name.endswith("_s"))
    if not all(math.isfinite(number) for number in seconds):
        return "a time is not finite"
    return None


def to_dict(row: Row) -> dict[str, Any]:
    """Return a row as plain JSON values."""
    return {field.name: getattr(row, field.name) for field in fields(Row)}


def from_dict(values: dict[str, Any]) -> Row:
    """Make a row of plain values, such as `to_dict`'s after a journey through JSON or Arrow.

    Raises:
        ValueError: the values are no row.
    """
    known = {field.name for field in fields(Row)}
    if unknown := sorted(set(values) - known):
        raise ValueError(f"unknown columns {clean(', '.join(map(str, unknown)), at_most=200)}")
    try:
        plain: dict[str, Any] = dict(values)
        plain["perturbation"] = tuple((str(a), float(v)) for a, v in values["perturbation"] or ())
        plain["waypoint_times"] = tuple(values["waypoint_times"] or ())
        return Row(**plain)
    except (KeyError, TypeError, OverflowError, struct.error) as error:
        raise ValueError(clean(error)) from error


def rows_digest(rows: Iterable[Row]) -> str:
    """Return one hex sha256 for a set of rows, whatever their order and wall times."""
    parts = sorted((row.trial_id, row.arm, row.digest) for row in rows)
    return sha256(json.dumps(parts).encode()).hexdigest()
