"""Sensors and wrappers of other packages: found by their installed name, or by `module:Class`.

Nothing of a package is imported before a card names it, so a broken one costs no other user
anything. Built-in names always win.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import CodeError, NwEvalError, PolicyError
from nw_base.files.importable import importable
from nw_base.memory import Arrays
from nw_base.plugins import SENSORS, WRAPPERS, installed, is_code, subject, warn_of_rivals
from nw_policies.cards.observations import PluginObservation
from nw_policies.cards.wrappers import PluginWrap
from nw_scenes.robots import RobotSpec
from nw_sim.sensors.sensor import Measurement, Sample, SceneView, Shot, StepContext, Wrapper


def make_plugin(
    name: str,
    group: str,
    arguments: tuple[Any, ...],
    parameters: Mapping[str, Any],
    *,
    code_from: Path | None,
) -> Any:
    """Import a plug-in's class and return an object of it.

    Args:
        name: as the card has it.
        group: the entry-point group.
        arguments: what every class of the group is called with.
        parameters: keyword arguments from the card.
        code_from: folder whose modules `module:Class` may name; None = it may name none.

    Raises:
        PolicyError: code is not allowed, or the plug-in is not installed.
        CodeError: the class cannot be imported, does not take these parameters, or can be saved
            but not restored. The message names the plug-in and its package.
    """
    if is_code(name):
        if code_from is None:
            raise PolicyError(
                f"{name!r} imports and runs Python code",
                fix="add --allow-code if you trust it",
            )
        called = name
    else:
        points = installed(group).get(name)
        if not points:
            raise PolicyError(f"no installed plug-in {name!r}", fix="install its package again")
        warn_of_rivals(points)
        called = subject(points[0])
    try:
        cls = _from_folder(name, code_from) if is_code(name) else installed(group)[name][0].load()
        plugin = cls(*arguments, **parameters)
    except NwEvalError:
        raise
    except Exception as error:
        where = f"in {code_from} or " if is_code(name) else ""
        raise CodeError(
            f"{called} cannot be opened: {type(error).__name__}: {error}",
            fix=f"its module must be {where}installed, and its class take the card's parameters"
            + (f" {sorted(parameters)}" if parameters else ""),
        ) from error
    _check_memory(plugin, called)
    return plugin


def remembers(plugin: Any) -> bool:
    """Whether a plug-in's object is a `Memory`."""
    return _has(plugin, "state") and _has(plugin, "restore")


def _check_memory(plugin: Any, where: str) -> None:
    if _has(plugin, "memory") and _has(plugin, "remember") and not remembers(plugin):
        raise CodeError(
            f"{where} has `memory` and `remember`, which are no longer called",
            fix="call them `state` and `restore`",
        )
    if _has(plugin, "state") != _has(plugin, "restore"):
        raise CodeError(
            f"{where} has only one of `state` and `restore`",
            fix="write both, or neither if it remembers nothing between samples",
        )


def _has(plugin: Any, method: str) -> bool:
    return callable(getattr(plugin, method, None))


def _from_folder(name: str, folder: Path | None) -> Any:
    module, _, cls = name.partition(":")
    with importable(folder):
        return getattr(importlib.import_module(module), cls)


class PluginSensor(Measurement):
    """A measurement by an object of a plug-in's class.

    The class is called as `Class(robot, **parameters)` and needs `shape`, `dtype` and
    `measure(moment)`. Whatever else of a measurement it has is used: `attach(place)`, `reset()`,
    `state()` with `restore(state)`, `unit`, `is_image`.

    Raises:
        CodeError: the class cannot be imported or made, or is no sensor.
    """

    def __init__(
        self,
        name: str,
        observation: PluginObservation,
        robot: RobotSpec,
        *,
        code_from: Path | None,
    ) -> None:
        self._name = name
        self._sensor = observation.sensor
        plugin = make_plugin(
            observation.sensor, SENSORS, (robot,), observation.parameters, code_from=code_from
        )
        for needed in ("shape", "dtype", "measure"):
            if not hasattr(plugin, needed):
                raise CodeError(
                    f"`{name}`: sensor {self._sensor} has no `{needed}`",
                    fix="a sensor needs `shape`, `dtype` and `measure(moment)`",
                )
        self._plugin = plugin
        self.shape: tuple[int, ...] = tuple(int(side) for side in plugin.shape)
        self.dtype = np.dtype(plugin.dtype)
        self.unit = str(getattr(plugin, "unit", "mixed"))
        self.is_image = bool(getattr(plugin, "is_image", False))

    def attach(self, place: SceneView) -> None:
        """Show it the scene."""
        self._call("attach", place)

    def reset(self) -> None:
        """Begin a trial."""
        self._call("reset")

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Ask it.

        Raises:
            CodeError: it raised, or returned another shape or type than it said.
        """
        sample = self._call("measure", moment)
        if not isinstance(sample, np.ndarray):
            form = type(sample).__name__
        elif sample.shape != self.shape or sample.dtype != self.dtype:
            form = f"{sample.shape} {sample.dtype}"
        else:
            return sample.copy()  # It may write the next sample into the same array.
        raise CodeError(
            f"`{self._name}`: sensor {self._sensor} returned {form}",
            fix=f"it declares that it returns {self.shape} {self.dtype}",
        )

    def state(self) -> Arrays:
        """Return what it remembers."""
        return self._call("state") or {} if remembers(self._plugin) else {}

    def restore(self, state: Arrays) -> None:
        """Go back to a `state`."""
        if remembers(self._plugin):
            self._call("restore", state)

    def _call(self, method: str, *arguments: Any) -> Any:
        """Call a method if the object has it."""
        function = getattr(self._plugin, method, None)
        if function is None:
            return None
        try:
            return function(*arguments)
        except NwEvalError:
            raise
        except Exception as error:
            raise CodeError(
                f"`{self._name}`: sensor {self._sensor}: {method} raised "
                f"{type(error).__name__}: {error}"
            ) from error


def foreign_wrapper(entry: PluginWrap, *, code_from: Path | None) -> Wrapper:
    """Return an object of a plug-in's class, with whatever methods it leaves out filled in.

    Raises:
        PolicyError: the class cannot be imported or made, or is no wrapper.
    """
    foreign = make_plugin(entry.wrapper, WRAPPERS, (), entry.parameters, code_from=code_from)
    if not callable(foreign):
        raise PolicyError(
            f"wrapper {entry.wrapper} has no method `__call__`",
            fix="write `def __call__(self, sample, shot)`",
        )
    return _Foreign(foreign)


class _Foreign:
    def __init__(self, wrapper: Any) -> None:
        self._wrapper = wrapper

    def __call__(self, sample: Sample, shot: Shot) -> Sample:
        # It may write into what it gets, and into what it has returned.
        result = self._wrapper(sample.copy(), shot)
        return np.array(result) if hasattr(result, "dtype") else result

    def reset(self, rng: np.random.Generator) -> None:
        if hasattr(self._wrapper, "reset"):
            self._wrapper.reset(rng)

    def state(self) -> Arrays:
        return self._wrapper.state() if remembers(self._wrapper) else {}

    def restore(self, state: Arrays) -> None:
        if remembers(self._wrapper):
            self._wrapper.restore(state)
