"""Shows a trial's readings to its scores, some control steps at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import UsageError
from nw_base.memory import pack, unpack
from nw_gate.scores import BUILT_IN, Figures, Score, Stretch, TrialEnd, score_class
from nw_gate.scores.own import Keeps
from nw_gate.scores.score import STRETCH

if TYPE_CHECKING:
    from nw_sim.physics import World
    from nw_sim.tasks import Task

Array = NDArray[np.float64]


class ScoreMeter:
    """The scores of one trial. A `Memory`: what is shown of it and of which steps.

    Args:
        names: of the scores.
        world: already reset to the trial's start.
        task: already reset.
        allow_code: whether Python functions of the suite may run.

    Raises:
        UsageError: there is no such score, or its class refuses.
    """

    def __init__(
        self, names: Sequence[str], world: World, task: Task, *, allow_code: bool = False
    ) -> None:
        self._world, self._task = world, task
        self._physics = world.at_physics_rate()
        self._figures = figures = Figures(
            control_period=world.control_period,
            timestep=world.timestep,
            mass=world.mass,
            gravity=world.gravity,
            torque_limits=world.torque_limits,
            joint_ranges=np.array(world.robot.joint_ranges, dtype=np.float64),
        )
        self._scores: dict[str, Score] = {}
        for name in names:
            try:
                cls = score_class(name, allow_code=allow_code)
                self._scores[cls.spec.name] = cls(figures)
            except UsageError:
                raise
            except Exception as error:
                own = name.partition("=")[0]
                raise UsageError(
                    f"score {own!r} cannot be opened: {clean(error, at_most=300)}",
                    fix="install its package, or remove it",
                ) from error
        substeps, joints = self._physics.rates.shape
        feet = len(world.robot.feet)
        shapes: dict[str, tuple[int, ...]] = {
            "servo": (substeps, joints),
            "joint_rates": (substeps, joints),
            "position": (3,),
            "rotation": (9,),
            "world_velocity": (3,),
            "rates": (3,),
            "joint_positions": (joints,),
            "targets": (joints,),
            "foot_positions": (feet, 3),
            "foot_forces": (feet,),
            "command": (3,),
        }
        # One row a control step, which one call fills.
        self._rows = np.zeros((STRETCH, sum(map(math.prod, shapes.values()))))
        self._forms: list[tuple[str, int, int, tuple[int, ...]]] = []
        start = 0
        for name, shape in shapes.items():
            self._forms.append((name, start, start + math.prod(shape), shape))
            start += math.prod(shape)
        # Views, so that they are always of the newest control step.
        rates = self._physics.servo.ravel(), self._physics.rates.ravel()
        self._views = *rates, *world.trunk_readings()
        self._count = 0

    def take(self, targets: Array) -> None:
        """Take the readings of the control step that was just made.

        Args:
            targets: what the motors were told, (J,).
        """
        world, command = self._world, self._task.command
        np.concatenate(
            (
                *self._views,
                world.joint_positions,
                targets,
                world.foot_positions.ravel(),
                world.foot_forces(),
                _UNASKED if command is None else command,
            ),
            out=self._rows[self._count],
        )
        self._count += 1
        if self._count == STRETCH:
            self._show()

    def values(self, end: TrialEnd) -> tuple[tuple[str, float], ...]:
        """Return the scores that are defined, by name."""
        if self._count:
            self._show()
        return _defined({name: score.value(end) for name, score in self._scores.items()})

    def so_far(self) -> dict[str, float]:
        """Return scores of the trial until now, by name; empty but after each `STRETCH` steps.

        In between, readings wait: to show them early would change the last bits of a sum. Scores of
        packages and functions of the suite are asked at the end alone, as they are promised.
        """
        if self._count:
            return {}
        end = TrialEnd(outcome=None, seconds=self._world.time, success=self._task.success)
        values = {
            name: score.value(end)
            for name, score in self._scores.items()
            if isinstance(score, Keeps) or type(score) is BUILT_IN.get(name)
        }
        return dict(_defined(values))

    def moments(self) -> dict[str, float]:
        """Return when in the trial limits were first passed, s, by score; after `values`."""
        by_score = {name: score.moment() for name, score in self._scores.items()}
        return {name: moment for name, moment in by_score.items() if moment is not None}

    def state(self) -> bytes:
        """Return what is not shown yet, and what the scores remember."""
        waiting = {_ROWS: self._rows[: self._count].copy()}
        for name, score in self._scores.items():
            waiting |= {f"{name}/{key}": array for key, array in score.state().items()}
        return pack(waiting)

    def restore(self, state: bytes) -> None:
        """Go back, or on, to a `state` of a trial with the same scores."""
        arrays = unpack(state)
        rows = arrays.pop(_ROWS)
        self._count = len(rows)
        self._rows[: self._count] = rows
        own: dict[str, dict[str, NDArray[np.float64]]] = {name: {} for name in self._scores}
        for key, array in arrays.items():
            of, _, name = key.partition("/")
            own[of][name] = array
        for name, score in self._scores.items():
            score.restore(own[name])

    def _show(self) -> None:
        count = self._count
        readings = {
            name: self._rows[:count, start:end].reshape(count, *shape)
            for name, start, end, shape in self._forms
        }
        readings["torques"] = self._physics.motor_torques(
            readings.pop("servo"), readings["joint_rates"]
        )
        stretch = Stretch(self._figures, **readings)
        for score in self._scores.values():
            score.update(stretch)
        self._count = 0


def _defined(values: Mapping[str, float | None]) -> tuple[tuple[str, float], ...]:
    return tuple(
        (name, float(value))
        for name, value in values.items()
        if value is not None and math.isfinite(value)
    )


_ROWS = "rows"
_UNASKED = np.full(3, math.nan)
