"""Wrappers of somebody else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nw_eval.cards.observations.plugins import WRAPPERS
from nw_eval.cards.observations.wrappers import PluginWrap
from nw_eval.errors import PolicyError
from nw_eval.memory import Arrays
from nw_eval.sensors.plugins import make_plugin, remembers
from nw_eval.sensors.wrappers.wrapper import Sample, Shot, Wrapper


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
