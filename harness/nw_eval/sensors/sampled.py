"""Rate and latency: which sample of a measurement the policy sees at which control step."""

from __future__ import annotations

from collections import deque
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.arrays import pack, read_only, unpack
from nw_eval.cards.model import CONTROL_RATE
from nw_eval.memory import Arrays
from nw_eval.scenes.scene import Nearness
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.sensor import Moment
from nw_eval.sensors.wrappers.chain import Chain
from nw_eval.sensors.wrappers.wrapper import Spec


class Sampled:
    """A sensor: a measurement taken at a rate, wrapped, and delivered after a latency.

    Samples are taken at steps 0, p, 2p, ... with p = 50 / rate. At a step the policy sees the
    newest sample that is at least `latency` old; until there is one, the first sample.

    Args:
        name: the observation's, on the card.
        measurement: what is sampled.
        rate: Hz.
        latency: s.
        chain: what a measurement passes through; None = nothing.
        first_step: the control step from which on there is something to see. Whatever was read
            before it is forgotten then.
    """

    def __init__(
        self,
        name: str,
        measurement: Measurement,
        *,
        rate: int = CONTROL_RATE,
        latency: float = 0.0,
        chain: Chain | None = None,
        first_step: int = 0,
    ) -> None:
        spec = Spec(measurement.shape, measurement.dtype)
        self._chain = Chain(name, (), spec) if chain is None else chain
        self._is_wrapped = bool(self._chain)
        self.name = name
        self.rate = rate
        self.shape = self._chain.spec.shape
        self.dtype = self._chain.spec.dtype
        self.unit = measurement.unit
        self.is_image = measurement.is_image
        self.fresh = False
        self._measurement = measurement
        self._period = CONTROL_RATE // rate
        self._delay = round(latency * CONTROL_RATE)
        self._first_step = first_step
        self._seed = 0
        # Samples with their steps: the one that is shown now, then those on their way.
        self._samples: deque[tuple[int, NDArray[Any]]] = deque()

    @property
    def coverage(self) -> float | None:
        """Share of the newest camera image that the splat covers, 0..1; None without an image."""
        return self._measurement.coverage

    @property
    def nearness(self) -> Nearness | None:
        """How far the newest camera image was taken from the nearest capture camera; or None."""
        return self._measurement.nearness

    def reset(self, seed: int) -> None:
        """Begin a trial; noise and wrappers draw from `seed` alone."""
        self._seed = seed
        self._samples.clear()
        self._measurement.reset()
        self._chain.reset(seed)
        self.fresh = False

    def read(self, moment: Moment) -> NDArray[Any]:
        """Return the sample that the policy sees at this step."""
        step = moment.step
        if self._first_step and step == self._first_step:
            self.reset(self._seed)
        samples = self._samples
        first = not samples
        self.fresh = first
        if first or step % self._period == 0:
            sample = self._measurement.measure(moment)
            if self._is_wrapped:
                sample = self._chain(sample, moment)
            sample = read_only(sample)  # It is shown at several steps, and logged.
            if not self._delay:
                samples.clear()
                self.fresh = True
            samples.append((step, sample))
        while len(samples) > 1 and samples[1][0] + self._delay <= step:
            samples.popleft()
            self.fresh = True
        return samples[0][1]

    def state(self) -> bytes:
        """Return the samples on their way, and what measurement and wrappers remember."""
        arrays: Arrays = {}
        memory = self._measurement.state()
        if len(self._samples) == 1 and not memory and not self._is_wrapped:
            step, sample = self._samples[0]  # As it mostly is.
            if sample.dtype.str[0] != ">":
                return _packed_sample(step, sample)
        if memory:
            arrays = {f"memory.{key}": value for key, value in memory.items()}
        if self._is_wrapped:
            arrays |= {f"chain.{key}": value for key, value in self._chain.state().items()}
        arrays["steps"] = np.array([step for step, _ in self._samples], dtype=np.int64)
        if len(self._samples) == 1:  # A view costs a third of an array.
            arrays["samples"] = self._samples[0][1][np.newaxis]
        elif self._samples:
            arrays["samples"] = np.array([sample for _, sample in self._samples])
        return pack(arrays)

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of the same trial, with the seed of the last `reset`."""
        arrays = unpack(state)
        steps = arrays.pop("steps").tolist()
        samples = read_only(arrays.pop("samples")) if steps else ()
        self._samples = deque(zip(steps, samples, strict=True))
        self._measurement.restore(_under("memory.", arrays))
        self._chain.restore(_under("chain.", arrays))
        self.fresh = False


def _packed_sample(step: int, sample: NDArray[Any]) -> bytes:
    """Return one sample as `pack` does: what stands before its numbers is the same every time."""
    return _head(sample.dtype.str, sample.shape) + step.to_bytes(8, "little") + sample.tobytes()


@lru_cache(maxsize=64)
def _head(kind: str, shape: tuple[int, ...]) -> bytes:
    """Return what `pack` puts before the step and the numbers of one little-endian sample."""
    steps, samples = np.zeros(1, np.int64), np.zeros((1, *shape), kind)
    return pack({"steps": steps, "samples": samples})[: -steps.nbytes - samples.nbytes]


def _under(prefix: str, arrays: Arrays) -> Arrays:
    return {
        key.removeprefix(prefix): value for key, value in arrays.items() if key.startswith(prefix)
    }
