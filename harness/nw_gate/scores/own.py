"""Scores that a suite makes up: what it expects of each trial, and Python functions of its own.

Each is a score like any other, so that rows, reports, gates and trackers have it. Jobs, logs and
the cache of trials know it by a text, `NAME={...}`, which says all of it, the code included.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import json
import math
import os
import threading
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NoReturn, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from nw_base.clean import clean
from nw_base.errors import CodeError, UsageError, is_interrupt, nearest
from nw_base.files.inside import OutsideError, bounded_bytes, inside
from nw_base.words import Outcome
from nw_gate.scores.score import (
    READINGS,
    Array,
    Figures,
    Score,
    ScoreSpec,
    Stretch,
    TrialEnd,
    unusable_range,
)

EXPECT = "expect_"
"""What the names of expectations begin with, as scores."""
Finite = Annotated[float, Field(allow_inf_nan=False)]


def _size(array: Array) -> Array:
    return np.abs(array)


_READINGS: dict[str, tuple[str, Callable[[Stretch], Array]]] = {
    "torque": ("N m", lambda stretch: _size(stretch.torques)),
    "torque_share": ("", lambda stretch: stretch.torque_shares),
    "joint_rate": ("rad/s", lambda stretch: _size(stretch.joint_rates)),
    "power": ("W", lambda stretch: stretch.power),
    "foot_force": ("N", lambda stretch: stretch.foot_forces[:, np.newaxis]),
    "roll": ("rad", lambda stretch: _size(stretch.roll)[:, np.newaxis, np.newaxis]),
    "pitch": ("rad", lambda stretch: _size(stretch.pitch)[:, np.newaxis, np.newaxis]),
    "speed": (
        "m/s",
        lambda stretch: np.hypot(stretch.world_velocity[:, 0], stretch.world_velocity[:, 1])[
            :, np.newaxis, np.newaxis
        ],
    ),
}
"""Unit, and what gives (n, S, K): K motors, feet or one trunk, S instants a control step."""
ReadingName = Literal[
    "torque", "torque_share", "joint_rate", "power", "foot_force", "roll", "pitch", "speed"
]


class Expectation(BaseModel):
    """What a suite expects of each trial; exactly one of `reading` and `score`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    reading: ReadingName | None = Field(
        None,
        description="torque (N m, the size of each motor's), torque_share (of its limit), "
        "joint_rate (rad/s), power (W, positive, of all motors), foot_force (N), roll, pitch (rad, "
        "their size) or speed (m/s, of the trunk in the ground plane). Torques, rates and power "
        "are looked at in each physics step, the others in each control step.",
    )
    score: str | None = Field(
        None, description="A score of docs/reference/scores.md, at the trial's end."
    )
    at_most: Finite | None = Field(None, description="The bound, in the unit of what it bounds.")
    at_least: Finite | None = Field(
        None, description="Its lower bound, in the same unit; with `score` only."
    )
    longer_than: Annotated[float, Field(ge=0.0, le=600.0)] = Field(
        0.0,
        description="s; a reading may be beyond the bound for so long at a time, each motor and "
        "each foot separately.",
    )

    @model_validator(mode="after")
    def _is_one_thing(self) -> Self:
        if (self.reading is None) == (self.score is None):
            raise ValueError("name either a reading or a score")
        if (self.at_most is None) == (self.at_least is None):
            raise ValueError("set either at_most or at_least")
        if self.score is not None and self.longer_than:
            raise ValueError("longer_than goes with a reading; a score is one number of a trial")
        if self.reading is not None and self.at_least is not None:
            raise ValueError("at_least goes with a score; a reading has an at_most")
        return self

    def sentence(self, unit: str) -> str:
        """Return it in words."""
        word, bound = (
            ("at most", self.at_most) if self.at_least is None else ("at least", self.at_least)
        )
        with_unit = f"{bound:g} {unit}".rstrip()
        if self.reading is None:
            return f"share of trials in which {self.score} is {word} {with_unit}"
        lasting = f" for more than {self.longer_than:g} s" if self.longer_than else ""
        return f"share of trials in which {self.reading} is never above {with_unit}{lasting}"


class OwnScore(BaseModel):
    """A score that a Python function computes, with its declaration."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    python: str = Field(
        pattern=r"^[^:]+\.py:[A-Za-z][A-Za-z0-9_]{0,63}$",
        description="A file beside the suite, and a function in it: `smooth.py:jerk`. Its "
        "parameters name the readings that it is given, of the complete trial.",
    )
    name: str | None = Field(None, description="What it is called; the function's name if None.")
    unit: str = Field("", max_length=40, description="Such as `W` or `rad/s`; empty for a share.")
    better: Literal["higher", "lower"] = Field(description="Which values are good.")
    range: tuple[Finite, Finite] = Field(description="Statistics see values clipped to it.")
    undefined: Finite | None = Field(
        None, description="What a trial without a value counts as; the worst end if None."
    )
    meaning: str = Field("", max_length=200, description="One line.")

    @property
    def spec(self) -> ScoreSpec:
        """Its declaration.

        Raises:
            ValidationError: the name is none that a score may have.
        """
        low, high = self.range
        worst = high if self.better == "lower" else low
        return ScoreSpec(
            name=self.name or self.python.rpartition(":")[2],
            unit=self.unit,
            better=self.better,
            low=low,
            high=high,
            undefined=worst if self.undefined is None else self.undefined,
            meaning=self.meaning or f"`{self.python}`",
        )

    @model_validator(mode="after")
    def _is_a_score(self) -> Self:
        low, high = self.range
        if fault := unusable_range(low, high):
            raise ValueError(fault)
        try:
            spec = self.spec
        except ValidationError:
            raise ValueError(
                "its name must be lower case: letters, digits and '_'; set `name`"
            ) from None
        if not low <= spec.undefined <= high:
            raise ValueError(f"undefined {spec.undefined:g} is not within its range")
        if spec.name.startswith(EXPECT):
            raise ValueError(f"names of scores do not begin with {EXPECT}; set `name`")
        return self


def expectation_spec(name: str, expected: Expectation, unit: str) -> ScoreSpec:
    """Return the declaration of an expectation: 1 where a trial keeps it, 0 where not.

    Args:
        name: as the suite has it.
        expected: what is expected.
        unit: of the score, where it is of one.
    """
    unit = unit if expected.reading is None else _READINGS[expected.reading][0]
    return ScoreSpec(
        name=EXPECT + name,
        unit="",
        better="higher",
        low=0.0,
        high=1.0,
        undefined=0.0,
        meaning=expected.sentence(unit),
    )


def expectation_text(name: str, expected: Expectation, of: str | None = None) -> str:
    """Return how jobs name an expectation.

    Args:
        name: as the suite has it.
        expected: what is expected.
        of: `own_text` of the score, where it is of a function's.
    """
    fields = expected.model_dump(exclude_defaults=True)
    if of is not None:
        fields["of"] = of
    return f"{EXPECT}{name}={json.dumps(fields, sort_keys=True)}"


_MOST_SOURCE = 64 * 1024


def own_text(own: OwnScore, folder: Path) -> str:
    """Return how jobs name a function's score: with its source.

    Raises:
        UsageError: the file cannot be read, is too long, or is seen to lack the function.
    """
    source = _source(own, folder)
    _vet(own, folder, source)
    fields = {**own.model_dump(exclude_none=True), "source": source}
    return f"{own.spec.name}={json.dumps(fields, sort_keys=True)}"


def _vet(own: OwnScore, folder: Path, source: str) -> None:
    """Refuse what no worker could use; nothing is run."""
    file, _, wanted = own.python.rpartition(":")
    where = f"score {own.spec.name!r}: {folder / file}"
    try:
        parsed = ast.parse(source)
    except (SyntaxError, ValueError) as error:
        line = getattr(error, "lineno", None) or 1
        message = f"{where}:{line}: {clean(getattr(error, 'msg', error), at_most=200)}"
        raise UsageError(message, fix="fix the file") from None
    functions = [each for each in parsed.body if isinstance(each, ast.FunctionDef)]
    function = next((each for each in reversed(functions) if each.name == wanted), None)
    if function is not None:
        _vet_parameters(
            own, [each.arg for each in (*function.args.args, *function.args.kwonlyargs)]
        )
    elif all(isinstance(each, _PLAIN) for each in parsed.body):
        known = [each.name for each in functions]
        raise UsageError(f"{where} has no function {wanted!r}", fix=nearest(wanted, known))


_PLAIN = (ast.FunctionDef, ast.ClassDef, ast.Import, ast.Expr)
"""Statements that give no function another name."""


def _vet_parameters(own: OwnScore, names: Sequence[str]) -> None:
    if unknown := [name for name in names if name not in GIVEN]:
        raise UsageError(
            f"score {own.spec.name!r}: {own.python} has a parameter {unknown[0]!r}, which is not a "
            "reading",
            fix=nearest(unknown[0], sorted(GIVEN)),
        )


def source_digest(own: OwnScore, folder: Path) -> str:
    """Return the hex SHA-256 of a function's file; raises as `own_text`."""
    return hashlib.sha256(_source(own, folder).encode()).hexdigest()


def _source(own: OwnScore, folder: Path) -> str:
    name = own.python.rpartition(":")[0]
    file = folder / name
    try:
        return bounded_bytes(inside(folder, name), _MOST_SOURCE).decode("utf-8")
    except OutsideError as error:
        raise UsageError(
            f"score {own.spec.name!r}: {clean(name, at_most=200)!r} leads out of {folder}: {error}",
            fix="copy it beside the suite, and name it from there",
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or clean(error, at_most=100)
        raise UsageError(
            f"cannot read {file} of score {own.spec.name!r}: {reason}",
            fix="name a file beside the suite, of UTF-8 text",
        ) from None


def is_code(text: str) -> bool:
    """Whether what a job names is a Python function."""
    return "=" in text and '"source": ' in text.replace('\\"', '"')


def class_of(text: str, inner: Callable[..., type[Score]], *, allow_code: bool) -> type[Score]:
    """Return the class of a score that a job names by `NAME={...}`.

    Args:
        text: of `expectation_text` or `own_text`.
        inner: gives the class of a score by name, or by such a text, and takes `allow_code`.
        allow_code: whether a function may be compiled and run.

    Raises:
        CodeError: it is a function, which may not.
        UsageError: the text is damaged; the code fails, or lacks the function.
    """
    name, _, written = text.partition("=")
    try:
        fields = json.loads(written)
        if name.startswith(EXPECT):
            of = fields.pop("of", None)
            expected = Expectation.model_validate(fields)
            return _expecting(
                name.removeprefix(EXPECT),
                expected,
                lambda name: inner(name if of is None else str(of), allow_code=allow_code),
            )
        source = str(fields.pop("source"))
        own = OwnScore.model_validate(fields)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UsageError(f"score {clean(name, at_most=80)!r} is damaged: {error}") from None
    if not allow_code:
        raise CodeError(
            f"score {own.spec.name!r} is Python code, {own.python}",
            fix="add --allow-code if you trust it",
        )
    return _computing(own, source)


def _expecting(
    name: str, expected: Expectation, inner: Callable[[str], type[Score]]
) -> type[Score]:
    if expected.score is None:
        declared = expectation_spec(name, expected, "")
        return type("Keeps", (Keeps,), {"spec": declared, "expected": expected})
    cls = inner(expected.score)
    declared = expectation_spec(name, expected, cls.spec.unit)
    return type("Reaches", (_Reaches,), {"spec": declared, "expected": expected, "of": cls})


_CUT_SHORT = frozenset[Outcome | None]({"fell", "collided", "policy_failed"})
"""Ends of trials that leave unknown what would have been measured."""


class Keeps(Score):
    """Whether a reading was never beyond a bound for longer than it may."""

    expected: ClassVar[Expectation]

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.instants, self.broken = 0, -1  # so far, and after how many it was first broken
        self.when = 0.0
        self.lasting = np.zeros(0)  # instants for which each has been beyond, without a break

    def update(self, stretch: Stretch) -> None:
        """Look for a longer time beyond the bound."""
        assert self.expected.reading is not None
        values = _READINGS[self.expected.reading][1](stretch)
        substeps, channels = values.shape[1:]
        # What is not a number was not measured, and keeps no bound.
        beyond = ~(values.reshape(-1, channels) <= (self.expected.at_most or 0.0))
        before, self.instants = self.instants, self.instants + len(beyond)
        if not beyond.any():
            self.lasting = np.zeros(channels)
            return
        instant = self.figures.control_period / substeps
        # The hair takes 0.1 s for no more than 0.1 s, which 20 times 0.005 s are not.
        most = self.expected.longer_than / instant + 1e-6
        lasting = self.lasting if len(self.lasting) else np.zeros(channels)
        for number, row in enumerate(beyond, before + 1):
            lasting = np.where(row, lasting + 1.0, 0.0)
            if self.broken < 0 and lasting.max() > most:
                self.broken = number
                self.when = number * instant
        self.lasting = lasting

    def value(self, end: TrialEnd) -> float | None:
        """Return 1 or 0; None where nothing was measured."""
        if end.outcome in _CUT_SHORT:
            return 0.0
        return float(self.broken < 0) if self.instants else None

    def moment(self) -> float | None:
        """Return when it was first broken, s."""
        return None if self.broken < 0 else self.when


class _Reaches(Score):
    """Whether a score keeps to a bound; one that is undefined keeps to none.

    Of a trial that was cut short, one of which less is better keeps to none either, and no score
    to an `at_most`: it had less time to grow.
    """

    expected: ClassVar[Expectation]
    of: ClassVar[type[Score]]

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.score = self.of(figures)

    def update(self, stretch: Stretch) -> None:
        """Show it the readings."""
        self.score.update(stretch)

    def value(self, end: TrialEnd) -> float | None:
        """Return 1 or 0."""
        value = self.score.value(end)
        if value is None or not math.isfinite(value):
            return 0.0  # A trial that never finishes does not finish within any bound.
        most = self.expected.at_most
        if end.outcome in _CUT_SHORT and (most is not None or self.of.spec.better == "lower"):
            return 0.0
        if most is not None:
            return float(value <= most)
        return float(value >= (self.expected.at_least or 0.0))

    def moment(self) -> float | None:
        """Return that of its score."""
        return self.score.moment()

    def state(self) -> dict[str, NDArray[Any]]:
        """Return what the score remembers."""
        return self.score.state()

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore the score."""
        self.score.restore(state)


_DERIVED = frozenset({"torque_shares", "peak_shares", "power", "roll", "pitch", "yaw", "velocity"})
GIVEN = frozenset({*READINGS, *_DERIVED, "figures", "end"})
"""What the parameters of a function may be called."""


def _computing(own: OwnScore, source: str) -> type[Score]:
    file, _, wanted = own.python.rpartition(":")
    module = types.ModuleType(f"nw_eval_score_{own.spec.name}")
    try:
        with _Stays():
            exec(compile(source, file, "exec"), module.__dict__)  # noqa: S102 - it is allowed.
        function = getattr(module, wanted)
        parameters = tuple(inspect.signature(function).parameters)
    except BaseException as error:
        if is_interrupt(error):
            raise
        raise UsageError(
            f"score {own.spec.name!r}: {own.python} cannot be loaded: "
            f"{type(error).__name__}: {clean(error, at_most=200)}",
            fix="fix the file",
        ) from None
    _vet_parameters(own, parameters)
    members = {"spec": own.spec, "function": staticmethod(function), "parameters": parameters}
    return type("Computed", (_Computed,), members)


class _Stays:
    """Makes SystemExit of `os._exit`: a process that ends so has ended by its policy's fault."""

    def __enter__(self) -> None:
        self._leave, own = os._exit, threading.get_ident()

        def leave(status: int) -> NoReturn:
            if threading.get_ident() == own:
                raise SystemExit(status)
            self._leave(status)  # A thread of ours may end the process at any time.

        os._exit = leave

    def __exit__(self, *_: object) -> None:
        os._exit = self._leave


class _Computed(Score):
    """What a function returns of the readings of all of a trial that its parameters name."""

    function: ClassVar[Callable[..., Any]]
    parameters: ClassVar[tuple[str, ...]]

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.seen: dict[str, list[Array]] = {
            name: [] for name in self.parameters if name not in {"figures", "end"}
        }

    def update(self, stretch: Stretch) -> None:
        """Keep the readings."""
        for name, arrays in self.seen.items():
            arrays.append(np.array(getattr(stretch, name)))

    def value(self, end: TrialEnd) -> float | None:
        """Call the function."""
        if not all(self.seen.values()):
            return None  # A trial without a step.
        own: dict[str, Any] = {"figures": self.figures, "end": end}
        given = {
            name: own[name] if name in own else np.concatenate(self.seen[name])
            for name in self.parameters
        }
        try:
            with _Stays():
                value = self.function(**given)
        except SystemExit as error:  # It would count as the policy's.
            message = f"score {self.spec.name!r}: its function left the process ({error})"
            raise RuntimeError(message) from None
        return None if value is None else float(value)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the readings so far."""
        return {name: np.concatenate(arrays) for name, arrays in self.seen.items() if arrays}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go back, or on, to some readings."""
        for name in self.seen:
            self.seen[name] = [state[name]] if name in state else []
