"""One trial's result: what a run is made of, and all that gate and report read."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import pairwise
from operator import attrgetter
from typing import Annotated, Any

from nw_base.clean import clean
from nw_base.words import FAULTS, OUTCOMES, Arm, Fault, Outcome, Status, Tier
from nw_gate.results.column import (
    Column,
    Numbers,
    Settings,
    as_kept,
    columns_of,
    mistyped,
    out_of_bounds,
)


@dataclass(frozen=True, kw_only=True)
class Row:
    """The result of one trial: digests are hex sha256, and each field says what it holds.

    The order is that of the file. A column that is added comes last, with `added=True`; nothing but
    what measures it need know. Texts may be a policy's or a file's: every one is made harmless and
    short (`clean.clean`).

    Raises:
        ValueError: a value is of the wrong type, too large, or contradicts another one.
    """

    trial_id: Annotated[str, Column("the trial's name: scene, index and perturbation")]
    suite: Annotated[str, Column("the suite's name", repeats=True)]
    scene: Annotated[str, Column("the scene's name", repeats=True)]
    task: Annotated[
        str, Column("what the scene asks for: hurdles, gaps, ramps, stairs, open", repeats=True)
    ]
    seed_index: Annotated[int, Column("number of the start in its scene, from 0")]
    seed: Annotated[int, Column("the trial's seed, as text; the same for every policy", bits=64)]
    policy: Annotated[str, Column("the policy's name", repeats=True)]
    arm: Annotated[
        Arm,
        Column(
            "`candidate`: the policy that is judged, and so far every row; `baseline` is kept "
            "for one that it is compared with"
        ),
    ] = "candidate"
    attempt: Annotated[
        int, Column("which attempt this is: 1, or more after an error", measured=True)
    ] = 1
    perturbation: Annotated[
        Settings,
        Column("what was changed, by the name of the axis (`friction`), and to which value"),
    ] = ()
    status: Annotated[Status, Column("`ok`: a result, counted; `error`: none, and counted apart")]
    outcome: Annotated[Outcome | Fault, Column("how the trial ended; see *Outcomes* and *Errors*")]
    end_reason: Annotated[
        str,
        Column(
            "what decided the outcome, such as `roll` or `contact face`; of a policy that "
            "failed, how; `error` for the machine's faults",
            repeats=True,
        ),
    ]
    completed: Annotated[bool, Column("whether all waypoints were reached")]
    success: Annotated[
        float | None,
        Column(
            "share of the course's waypoints reached, 0 to 1: what is averaged and judged; none "
            "for an error, so that no mean includes it"
        ),
    ]
    waypoints_reached: Annotated[int, Column("number of waypoints reached, in their order")]
    waypoints_total: Annotated[int, Column("number of waypoints of the course")]
    waypoint_times: Annotated[Numbers, Column("when each was reached, simulated s")] = ()
    steps: Annotated[
        int, Column("control steps done, 50 a simulated second or as many as the card's rate")
    ]
    sim_s: Annotated[float, Column("simulated s")]
    physics_s: Annotated[float, Column("wall s spent on physics", measured=True)]
    render_s: Annotated[
        float, Column("wall s spent on camera images, for the policy or the log", measured=True)
    ]
    policy_s: Annotated[float, Column("wall s spent on the policy", measured=True)]
    log_s: Annotated[float, Column("wall s spent on the log, but for rendering", measured=True)]
    wall_s: Annotated[
        float, Column("wall s of all of the trial, sensors and set-up included", measured=True)
    ]
    coverage_min: Annotated[
        float | None,
        Column(
            "smallest share, 0 to 1, of a camera image of the policy's that the splat covers: "
            "far below 1, the robot looked where nothing was captured; none without such "
            "images"
        ),
    ] = None
    coverage_mean: Annotated[
        float | None, Column("mean share over all those images; none without them")
    ] = None
    state_digest: Annotated[
        str, Column("SHA-256 over all states: equal ones are equal trajectories, bit for bit")
    ] = ""
    action_digest: Annotated[
        str, Column("SHA-256 over all applied actions: equal ones are equal bit for bit")
    ] = ""
    checkpoint_digest: Annotated[str, Column("SHA-256 of the checkpoint, or of the policy's code")]
    scene_digest: Annotated[str, Column("SHA-256 of what the scene is made of")]
    cached: Annotated[
        bool,
        Column(
            "whether the row comes from an earlier run, by the cache of trials, so that "
            "its times are none of this run's",
            measured=True,
        ),
    ] = False
    host: Annotated[str, Column("the machine's name", repeats=True, measured=True)] = ""
    mcap_path: Annotated[
        str, Column("the log within the run's folder; empty without one", measured=True)
    ] = ""
    mcap_bytes: Annotated[int, Column("size of the log, bytes", bits=63, measured=True)] = 0
    error_type: Annotated[
        str, Column("kind of the error, also of a policy that failed; or empty", repeats=True)
    ] = ""
    error_text: Annotated[str, Column("what went wrong, in one line; or empty")] = ""
    contact_s: Annotated[
        float,
        Column("simulated s with head or trunk in contact", added=True),
    ] = 0.0
    robot: Annotated[
        str,
        Column(
            "which robot: its name, and `@` with its identity if it is not built in",
            repeats=True,
            of_the_plan=True,
        ),
    ]
    tier: Annotated[
        Tier,
        Column("how much the scene counts: critical, supporting, informational", of_the_plan=True),
    ] = "supporting"
    setup_s: Annotated[
        float,
        Column("wall s before the first step: scene, world and policy", measured=True, added=True),
    ] = 0.0
    sense_s: Annotated[
        float, Column("wall s spent on observations that are no images", measured=True, added=True)
    ] = 0.0
    mcap_sha256: Annotated[
        str,
        Column(
            "SHA-256 of the log as it was when the trial ended; empty without one",
            measured=True,
            added=True,
        ),
    ] = ""
    capture_distance: Annotated[
        Numbers,
        Column(
            "how far the policy's camera was from the nearest of those that the scene was "
            "photographed with, m: the largest of each tenth of a simulated second; empty where "
            "the policy sees no splat, or the scene has no `captures`",
            added=True,
        ),
    ] = ()
    capture_angle: Annotated[
        Numbers,
        Column("angle between the optical axes of these two, rad: also the largest", added=True),
    ] = ()
    capture_alpha: Annotated[
        Numbers,
        Column(
            "share of the camera's image that the splat covers, 0 to 1: the smallest of each "
            "tenth of a second",
            added=True,
        ),
    ] = ()

    task_kind: Annotated[
        str,
        Column(
            "which kind of task it was: `course`, or what the suite's `task` names",
            repeats=True,
            added=True,
        ),
    ] = "course"
    scores: Annotated[
        Settings,
        Column(
            "scores by name, each in its unit; one that is undefined is not there, and empty "
            "where the suite names none",
            added=True,
        ),
    ] = ()

    def __post_init__(self) -> None:
        fault = mistyped(vars(self), COLUMNS)
        if fault is None:
            vars(self).update(as_kept(vars(self), COLUMNS))
            fault = _contradiction(*_OF_AN_END(self)) or out_of_bounds(vars(self), COLUMNS)
        if fault is not None:
            raise ValueError(f"row of trial {clean(self.trial_id, at_most=100)!r}: {fault}")

    @cached_property
    def digest(self) -> str:
        """Hex sha256 of the result: all columns but the measured ones and the plan's.

        What a policy said as it failed is no part of it: that may name a process, a path or the
        time. How it failed, where and after which actions, is. Nor is a column that came later,
        where it has its default.
        """
        kept = dict(zip(_WORDS, _RESULT(self), strict=True))
        for name, default in _CAME_LATER:
            if kept[name] == default:
                del kept[name]
        if self.outcome == "policy_failed":
            kept["error_text"] = ""
        return sha256(_ENCODE(kept).encode()).hexdigest()

    @property
    def standing(self) -> str:
        """How far the trial came, for people: `3/4` waypoints, or the success of a task without."""
        if self.waypoints_total:
            return f"{self.waypoints_reached}/{self.waypoints_total}"
        return "" if self.success is None else f"{self.success:.2f}"

    @property
    def lost_its_log(self) -> bool:
        """Whether it has a result and no log, which could not be written.

        A policy that failed may have taken its process, and so the log, with it.
        """
        return self.status == "ok" and self.outcome != "policy_failed" and not self.mcap_path


def task_shown(scene: str, task: str) -> str:
    """Return what tables call the task of a scene.

    That without a course has the key `hurdles` in rows: trials are named by it.
    """
    return "flat" if scene.startswith("flat/") else task


def self_contradiction(row: Row) -> str | None:
    """Return in what a row contradicts itself, as none that a trial makes does, or None.

    What `Row` itself refuses is not repeated here: words, bounds of single values, and an outcome
    that does not go with the status. This is for rows that are read to be judged.
    """
    if row.status == "error":
        return "an error is completed" if row.completed else None
    reached, total = row.waypoints_reached, row.waypoints_total
    ended = contradiction_of_end(
        row.outcome, reached, total, row.success, completed=row.completed, kind=row.task_kind
    )
    return ended or _contradiction_of_times(row)


def contradiction_of_end(
    outcome: str,
    reached: int,
    total: int,
    success: float | None,
    *,
    completed: bool,
    kind: str = "course",
) -> str | None:
    """Return in what the end of a trial that has a result contradicts itself, or None."""
    if total < 1 and kind != "course":  # Such a task scores otherwise.
        if completed != (outcome == "completed"):
            return f"completed is {completed} and the outcome {outcome}"
        return None
    if total < 1:
        if outcome == "policy_failed" and (reached, success, completed) == (0, 0.0, False):
            return None  # It ended its process, or failed before it stood: there is no count.
        return f"success {success} of a course without waypoints"
    if success is None or abs(success - reached / total) > _ROUNDING:
        return f"success {success} with {reached} of {total} waypoints reached"
    if completed != (outcome == "completed"):
        return f"completed is {completed} and the outcome {outcome}"
    return None


def _contradiction_of_times(row: Row) -> str | None:
    """Return in what counts and times of a result contradict each other, or None."""
    times, sim_s = row.waypoint_times, row.sim_s
    if len(times) != row.waypoints_reached:
        return f"{len(times)} waypoint_times of {row.waypoints_reached} waypoints reached"
    if any(later < earlier for earlier, later in pairwise((0.0, *times))):
        return "waypoint_times go back"
    if times and times[-1] > sim_s + _SINGLE:
        return f"a waypoint reached at {times[-1]:.3f} s of {sim_s:.3f} s"
    if not _is_rate(row.steps, sim_s):
        return f"{row.steps} steps, {CONTROL_RATE} a second, in {sim_s:.3f} s"
    if not 0.0 <= row.contact_s <= sim_s + _ROUNDING:
        return f"{row.contact_s:.3f} s in contact of {sim_s:.3f} s"
    least, mean = row.coverage_min, row.coverage_mean
    if least is None and mean is None:
        return None
    if least is None or mean is None or not 0.0 <= least <= mean + _ROUNDING:
        return f"coverage_min {least} and coverage_mean {mean}"
    return f"coverage_mean {mean}" if mean > 1.0 + _ROUNDING else None


def _is_rate(steps: int, seconds: float) -> bool:
    """Return whether so many control steps can last so long.

    A step is 0.02 s, or as many physics steps, up to 2000 a second, as a card's rate asks for.
    """
    if abs(steps / CONTROL_RATE - seconds) <= _ROUNDING:
        return True
    if steps < 1 or seconds <= 0.0:
        return False
    rate = steps / seconds
    if abs(CONTROL_RATE / rate - round(CONTROL_RATE / rate)) <= _ROUNDING:
        return False  # Such a policy has steps of 0.02 s.
    for substeps in range(1, int(_MOST_PHYSICS / rate) + 1):
        physics = round(rate * substeps)
        if abs(steps * substeps - seconds * physics) <= _ROUNDING * physics:
            return True
    return False


CONTROL_RATE = 50
"""Control steps in a simulated second, where the policy's rate divides it."""
_MOST_PHYSICS = 2000
"""Physics steps in a simulated second at most."""

_ROUNDING = 1e-6
_SINGLE = 1e-3  # s by which single precision moves a time of hours.

_END = ("status", "outcome", "waypoints_reached", "waypoints_total", "success", "completed")
_OF_AN_END = attrgetter(*_END)


def _contradiction(
    status: str, outcome: str, reached: int, total: int, success: float | None, completed: bool
) -> str | None:
    """Return what contradicts itself in how a trial ended, or None."""
    known = OUTCOMES if status == "ok" else FAULTS
    if outcome not in known:
        return f"outcome {outcome!r} does not go with status {status!r}"
    if not 0 <= reached <= total:
        return f"{reached} of {total} waypoints reached"
    if status == "error":
        return None if success is None else f"an error has a success ({success})"
    if success is None or not 0.0 <= success <= 1.0:
        return f"success {success} is not between 0 and 1"
    if completed != (success == 1.0):
        return f"completed is {completed} at success {success}"
    return None


COLUMNS = columns_of(Row)
"""What each field says, in the order of the file."""

MEASURED = frozenset(name for name, column in COLUMNS.items() if column.measured)
OF_THE_PLAN = frozenset(name for name, column in COLUMNS.items() if column.of_the_plan)
VIEW_RATE = 10
"""Numbers of `capture_distance`, `capture_angle` and `capture_alpha` in a simulated second."""

_CALLED = {"success": "fraction"}
"""What the digest calls a column: as it was called when the first digests were published."""

_DIGESTED = sorted(
    (_CALLED.get(name, name), name) for name in COLUMNS if name not in MEASURED | OF_THE_PLAN
)
"""The columns of a row's digest, in its order."""
_WORDS = tuple(word for word, _ in _DIGESTED)

# `contact_s` came before later ones were left out.
_CAME_LATER = tuple(
    (name, COLUMNS[name].default)
    for _, name in _DIGESTED
    if COLUMNS[name].added and name != "contact_s"
)
"""Those that the digest leaves out while they have their defaults."""

_RESULT, _ALL = attrgetter(*(name for _, name in _DIGESTED)), attrgetter(*COLUMNS)
_ENCODE = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


def to_dict(row: Row) -> dict[str, Any]:
    """Return a row as plain JSON values."""
    return dict(zip(COLUMNS, _ALL(row), strict=True))


def from_dict(values: dict[str, Any]) -> Row:
    """Make a row of plain values, such as `to_dict`'s after a journey through JSON or Arrow.

    Raises:
        ValueError: the values are no row.
    """
    if unknown := sorted(values.keys() - COLUMNS.keys()):
        raise ValueError(f"unknown columns {clean(', '.join(map(str, unknown)), at_most=200)}")
    try:
        lists = {
            name: column.of_plain(values[name]) for name, column in COLUMNS.lists if name in values
        }
        return Row(**{**values, **lists})
    except (TypeError, OverflowError, struct.error) as error:
        raise ValueError(clean(error)) from error


def rows_digest(rows: Iterable[Row]) -> str:
    """Return one hex sha256 for a set of rows, whatever their order and wall times."""
    return _digest_of([(row.trial_id, row.arm, row.digest) for row in rows])


def rows_of(values: Iterable[dict[str, Any]], digest: str | None) -> Iterator[Row]:
    """Yield the rows of plain values; as `from_dict`.

    Args:
        values: of each row.
        digest: the `rows_digest` that they must have, which shows at the end; None = any.

    Raises:
        ValueError: as `from_dict`, or they have another digest.
    """
    results: list[tuple[str, str, str]] = []
    for one in values:
        row = from_dict(one)
        results.append((row.trial_id, row.arm, row.digest))
        yield row
    if digest is not None and digest != _digest_of(results):
        raise ValueError("its rows are not those of its rows_digest")


def _digest_of(results: list[tuple[str, str, str]]) -> str:
    """Return the hex sha256 of trial, arm and digest of all rows, sorted."""
    return sha256(json.dumps(sorted(results)).encode()).hexdigest()
