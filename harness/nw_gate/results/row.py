"""One trial's result: what a run is made of, and all that gate and report read.

Many rows become the JSON that is written and hashed a column at a time, once for all that needs
it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import pairwise
from json.encoder import encode_basestring_ascii
from operator import attrgetter
from typing import Annotated, Any

from nw_base.clean import clean
from nw_base.words import FAULTS, OUTCOMES, Arm, Fault, Outcome, Status, Tier
from nw_gate.results.column import (
    Column,
    Numbers,
    Settings,
    all_as_kept,
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

    @property
    def digest(self) -> str:
        """Hex sha256 of the result: all columns but the measured ones and the plan's.

        What a policy said as it failed is no part of it: that may name a process, a path or the
        time. How it failed, where and after which actions, is. Nor is a column that came later,
        where it has its default.
        """
        kept = dict(zip(_OF_THE_RESULT, _RESULT(self), strict=True))
        for name in _CAME_LATER:
            if not COLUMNS[name].in_digest(kept[name]):
                del kept[name]
        for name, word in _CALLED.items():
            kept[word] = kept.pop(name)
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

_AT_ONCE = 1000
"""Rows that are turned into columns together: few enough for a processor's cache."""

_OF_THE_RESULT = tuple(name for name in COLUMNS if name not in MEASURED | OF_THE_PLAN)
"""The columns of a row's digest."""

# `contact_s` came before later ones were left out.
_CAME_LATER = tuple(name for name in _OF_THE_RESULT if COLUMNS[name].added and name != "contact_s")
"""Those that the digest leaves out while they have their defaults."""

_CALLED = {"success": "fraction"}
"""What the digest calls a column: as it was called when the first digests were published."""

_RESULT, _ALL = attrgetter(*_OF_THE_RESULT), attrgetter(*COLUMNS)
_ENCODE = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False).encode


def to_dict(row: Row) -> dict[str, Any]:
    """Return a row as plain JSON values."""
    return dict(zip(COLUMNS, _ALL(row), strict=True))


def by_column(rows: Sequence[Row], names: Collection[str] = COLUMNS) -> dict[str, list[Any]]:
    """Return values of rows by column: faster by far than one column after the other.

    Args:
        rows: in any order.
        names: of two columns or more.
    """
    columns: dict[str, list[Any]] = {name: [] for name in names}
    values_of = attrgetter(*names)
    for first in range(0, len(rows), _AT_ONCE):
        some = map(values_of, rows[first : first + _AT_ONCE])
        for name, values in zip(names, zip(*some, strict=True), strict=True):
            columns[name].extend(values)
    return columns


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


def from_dicts(values: Sequence[dict[str, Any]]) -> list[Row]:
    """Make many rows of plain values; the same as `from_dict` of each, in a tenth of the time.

    The dictionaries become the rows' own.

    Raises:
        ValueError: as the first of them that is no row.
    """
    return _quickly(values) or [from_dict(one) for one in values]


def _quickly(values: Sequence[dict[str, Any]]) -> list[Row] | None:
    """Return rows whose columns alone show that they are valid; None where one is not."""
    if not values or (names := list(values[0])) != list(COLUMNS):
        return None  # The columns of another version, or in another order.
    if not all(list(one) == names for one in values):
        return None
    columns = zip(*(one.values() for one in values), strict=True)
    table: dict[str, Sequence[Any]] = dict(zip(names, columns, strict=True))
    try:
        for name, column in COLUMNS.lists:
            table[name] = [column.of_plain(value) for value in table[name]]
        if not all_as_kept(table, COLUMNS):
            return None
    except (TypeError, ValueError, OverflowError):
        return None
    if any(_contradiction(*end) for end in set(zip(*map(table.__getitem__, _END), strict=True))):
        return None
    lists = [name for name, _ in COLUMNS.lists]
    tuples = zip(*map(table.__getitem__, lists), strict=True)
    for one, of_row in zip(values, tuples, strict=True):
        one.update(zip(lists, of_row, strict=True))
    return [_of_kept(one) for one in values]


def _of_kept(values: dict[str, Any]) -> Row:
    """Return the row of values that are as `__post_init__` would leave them."""
    row = object.__new__(Row)
    object.__setattr__(row, "__dict__", values)
    return row


_FEW = 8  # values for each different one, from which on each is encoded once
_VALUE = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode
_LINES = json.JSONEncoder(separators=("\n", ":"), allow_nan=False).encode
"""JSON holds no line's end but between values: a column of it can be split into those."""

_DIGESTED = tuple(
    sorted((_CALLED.get(name, name), name) for name in _OF_THE_RESULT if name not in _CAME_LATER)
)
_RECORD = '{"row":{' + ",".join(f'"{name}":%s' for name in COLUMNS) + "}}"
_DIGEST = "{" + ",".join(f'"{word}":%s' for word, _ in _DIGESTED) + "}"


@dataclass(frozen=True)
class RowTexts:
    """Some rows, and the JSON of each of their values, by column in the order of the file."""

    rows: Sequence[Row]
    values: Mapping[str, Sequence[Any]]
    texts: Mapping[str, Sequence[str]]

    def records(self) -> Iterator[str]:
        """Return each row as a line of the journal has it, without its sum."""
        return map(_RECORD.__mod__, zip(*self.texts.values(), strict=True))

    def digests(self) -> list[str]:
        """Return the `digest` of each row."""
        for name in _CAME_LATER:
            if any(map(COLUMNS[name].in_digest, self.values[name])):
                return [row.digest for row in self.rows]
        texts = {**self.texts, "error_text": self._error_texts()}
        columns = (texts[name] for _, name in _DIGESTED)
        return [
            sha256((_DIGEST % of_row).encode()).hexdigest() for of_row in zip(*columns, strict=True)
        ]

    def _error_texts(self) -> Sequence[str]:
        """Return what digests have of them: nothing of what a policy said as it failed."""
        texts, outcomes = self.texts["error_text"], self.values["outcome"]
        if "policy_failed" not in outcomes:
            return texts
        pairs = zip(texts, outcomes, strict=True)
        return ['""' if outcome == "policy_failed" else text for text, outcome in pairs]


def rows_digest(rows: Iterable[Row]) -> str:
    """Return one hex sha256 for a set of rows, whatever their order and wall times."""
    results = Results()
    for texts in texts_of(list(rows)):
        results.extend(texts)
    return results.digest


class Results:
    """What the `rows_digest` of rows covers, in a hundred bytes a row. Ask once all are there.

    Attributes:
        trials: names, in the order of the rows.
        arms: as above.
        digests: 32 bytes of each.
    """

    def __init__(self) -> None:
        self.trials: list[str] = []
        self.arms: list[str] = []
        self.digests = bytearray()

    def extend(self, texts: RowTexts) -> None:
        """Add rows."""
        self.trials += texts.values["trial_id"]
        self.arms += texts.values["arm"]
        self.digests += bytes.fromhex("".join(texts.digests()))

    @cached_property
    def order(self) -> list[int]:
        """Places of the rows, sorted by trial, arm and digest."""
        order = sorted(range(len(self.trials)), key=self.trials.__getitem__)
        if all(self.trials[one] != self.trials[two] for one, two in pairwise(order)):
            return order  # A run has one row of each trial: nothing else need be compared.
        return sorted(order, key=self._result)

    @property
    def digest(self) -> str:
        """The hex sha256 of the JSON list of trial, arm and digest of all rows, sorted."""
        found, order = sha256(b"["), self.order
        for first in range(0, len(order), _AT_ONCE):
            some = json.dumps(list(map(self._result, order[first : first + _AT_ONCE])))
            found.update(f"{', ' if first else ''}{some[1:-1]}".encode())
        found.update(b"]")
        return found.hexdigest()

    def _result(self, place: int) -> tuple[str, str, str]:
        digest = self.digests[32 * place : 32 * place + 32].hex()
        return self.trials[place], self.arms[place], digest


def texts_of(rows: Sequence[Row]) -> Iterator[RowTexts]:
    """Yield rows in portions, in their order."""
    for first in range(0, len(rows), _AT_ONCE):
        some = rows[first : first + _AT_ONCE]
        values = by_column(some)
        texts = {name: _encoded(values[name], column) for name, column in COLUMNS.items()}
        yield RowTexts(some, values, texts)


def _encoded(values: Sequence[Any], column: Column) -> Sequence[str]:
    """Return the JSON of each value of a column."""
    if column.types is str:
        return _encoded_words(values)
    if not column.is_list:
        return _LINES(values)[1:-1].split("\n")
    if column.kind == Numbers:
        return [f"[{numbers}]" for numbers in _VALUE(values)[2:-2].split("],[")]
    return [_VALUE(value) if value else "[]" for value in values]


def _encoded_words(words: Sequence[str]) -> Sequence[str]:
    distinct = set(words)
    if _FEW * len(distinct) > len(words):
        return list(map(encode_basestring_ascii, words))
    encoded = {word: encode_basestring_ascii(word) for word in distinct}
    return [encoded[word] for word in words]
