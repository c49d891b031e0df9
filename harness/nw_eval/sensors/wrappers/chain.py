"""Wrappers around a sensor, in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nw_eval.errors import CodeError, NwEvalError, PolicyError
from nw_eval.memory import Arrays
from nw_eval.sensors.sensor import Moment
from nw_eval.sensors.wrappers.wrapper import Sample, Shot, Spec, Wrapper


@dataclass(frozen=True, kw_only=True)
class NamedWrapper:
    """A wrapper and what people call it."""

    name: str
    wrapper: Wrapper


class Chain:
    """Passes samples of one observation through its wrappers.

    Args:
        observation: its name on the card, for errors.
        wrappers: in order.
        start: what goes in.

    Attributes:
        spec: what comes out.

    Raises:
        PolicyError: a wrapper cannot take what comes to it.
    """

    def __init__(self, observation: str, wrappers: Sequence[NamedWrapper], start: Spec) -> None:
        self._observation = observation
        self._wrappers = tuple(wrappers)
        self._seed = 0
        self.spec = start
        self._specs: list[Spec] = []
        for number, named in enumerate(self._wrappers):
            self.spec = self._trial_run(number, named, self.spec)
            self._specs.append(self.spec)

    def __bool__(self) -> bool:
        return bool(self._wrappers)

    def reset(self, seed: int) -> None:
        """Begin a trial, whose randomness all comes from `seed`."""
        self._seed = seed
        for number, named in enumerate(self._wrappers):
            # Counters of samples start at 0 in another dimension than this one's.
            named.wrapper.reset(_generator(seed, number, -1))

    def __call__(self, sample: Sample, moment: Moment) -> Sample:
        """Return what the policy sees of a sample.

        Raises:
            PolicyError: a wrapper raised, or returned another shape or type than on its trial run.
        """
        for number, named in enumerate(self._wrappers):
            sample = self._pass(number, named, sample, moment.step, moment)
            spec = self._specs[number]
            if sample.shape != spec.shape or sample.dtype != spec.dtype:
                raise PolicyError(
                    f"`{self._observation}`: wrapper {named.name} returned {_form_of(sample)}, on "
                    f"its trial run {spec.shape} {spec.dtype}",
                    fix="a wrapper's output keeps its shape and type",
                )
        return sample

    def state(self) -> Arrays:
        """Return what all wrappers remember."""
        return {
            f"{number}.{key}": value
            for number, named in enumerate(self._wrappers)
            for key, value in named.wrapper.state().items()
        }

    def restore(self, state: Arrays) -> None:
        """Go back to a `state`."""
        for number, named in enumerate(self._wrappers):
            own = f"{number}."
            named.wrapper.restore(
                {key.removeprefix(own): state[key] for key in state if key.startswith(own)}
            )

    def _trial_run(self, number: int, named: NamedWrapper, spec: Spec) -> Spec:
        """Return what a wrapper makes of a sample of ones."""
        named.wrapper.reset(_generator(0, number, -1))
        sample = self._pass(number, named, np.ones(spec.shape, spec.dtype), 0, None)
        named.wrapper.reset(_generator(0, number, -1))
        return Spec(sample.shape, sample.dtype)

    def _pass(
        self, number: int, named: NamedWrapper, sample: Sample, step: int, moment: Moment | None
    ) -> Sample:
        seed = self._seed
        shot = Shot(step, moment, lambda at: _generator(seed, number, at))
        try:
            result = named.wrapper(sample, shot)
        except NwEvalError as error:
            raise PolicyError(f"`{self._observation}`: {error}") from None
        except Exception as error:
            raise CodeError(
                f"`{self._observation}`: wrapper {named.name} raised {type(error).__name__} on "
                f"{_form_of(sample)}: {error}",
                fix="look at its input with `nw-eval sensors CARD`",
            ) from error
        if not hasattr(result, "dtype"):  # A plug-in may return anything.
            raise CodeError(
                f"`{self._observation}`: wrapper {named.name} returned a {type(result).__name__}",
                fix="return a NumPy array",
            )
        return np.asarray(result)


def _form_of(sample: Sample) -> str:
    return f"{sample.shape} {sample.dtype}"


def _generator(seed: int, number: int, step: int) -> np.random.Generator:
    # Philox is a block cipher over a counter: any block of it costs the same as the first.
    key = np.array([seed, number], dtype=np.uint64)
    counter = np.array([0, 0, step + 1, 0], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=counter))
