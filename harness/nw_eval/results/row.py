"""One trial's result: what a run is made of, and all that gate and report read."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, fields
from hashlib import sha256
from typing import Any, Literal, get_args

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

    def __post_init__(self) -> None:
        times = tuple(struct.unpack("f", struct.pack("f", t))[0] for t in self.waypoint_times)
        object.__setattr__(self, "waypoint_times", times)
        fault = _fault(self)
        if fault is not None:
            raise ValueError(f"row of trial {self.trial_id!r}: {fault}")

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
        raise ValueError(f"unknown columns {', '.join(unknown)}")
    try:
        plain: dict[str, Any] = dict(values)
        plain["perturbation"] = tuple((str(a), float(v)) for a, v in values["perturbation"] or ())
        plain["waypoint_times"] = tuple(values["waypoint_times"] or ())
        return Row(**plain)
    except (KeyError, TypeError, struct.error) as error:
        raise ValueError(str(error)) from error


def rows_digest(rows: Iterable[Row]) -> str:
    """Return one hex sha256 for a set of rows, whatever their order and wall times."""
    parts = sorted((row.trial_id, row.arm, row.digest) for row in rows)
    return sha256(json.dumps(parts).encode()).hexdigest()
