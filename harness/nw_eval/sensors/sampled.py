"""Rate and latency: which sample of a measurement the policy sees at which control step."""

from __future__ import annotations

from collections import deque
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_eval.policies.model import CONTROL_RATE
from nw_eval.sensors.arrays import pack, unpack
from nw_eval.sensors.sensor import Moment


class Measurement(Protocol):
    """What a sensor measures each time that it samples."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a sample."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a sample."""
        ...

    @property
    def unit(self) -> str:
        """As `Sensor.unit`."""
        ...

    @property
    def is_image(self) -> bool:
        """As `Sensor.is_image`."""
        ...

    @property
    def coverage(self) -> float | None:
        """As `Sensor.coverage`."""
        ...

    def reset(self) -> None:
        """Forget earlier samples."""
        ...

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Return a new sample, in memory of its own."""
        ...

    def memory(self) -> dict[str, NDArray[Any]]:
        """Return what the next samples depend on beside the moment."""
        ...

    def remember(self, memory: dict[str, NDArray[Any]]) -> None:
        """Go back to a `memory`."""
        ...


class Sampled:
    """A sensor: a measurement taken at a rate and delivered after a latency.

    Samples are taken at steps 0, p, 2p, ... with p = 50 / rate. At a step the policy sees the
    newest sample that is at least `latency` old; until there is one, the first sample.
    """

    def __init__(
        self, name: str, measurement: Measurement, *, rate: int = CONTROL_RATE, latency: float = 0.0
    ) -> None:
        self.name = name
        self.rate = rate
        self.shape = measurement.shape
        self.dtype = measurement.dtype
        self.unit = measurement.unit
        self.is_image = measurement.is_image
        self.fresh = False
        self._measurement = measurement
        self._period = CONTROL_RATE // rate
        self._delay = round(latency * CONTROL_RATE)
        # Samples with their steps: the one that is shown now, then those on their way.
        self._samples: deque[tuple[int, NDArray[Any]]] = deque()

    @property
    def coverage(self) -> float | None:
        """Share of the newest camera image that the splat covers, 0..1; None without an image."""
        return self._measurement.coverage

    def reset(self, seed: int) -> None:  # noqa: ARG002 - no sensor has noise yet.
        """Begin a trial."""
        self._samples.clear()
        self._measurement.reset()
        self.fresh = False

    def read(self, moment: Moment) -> NDArray[Any]:
        """Return the sample that the policy sees at this step."""
        first = not self._samples
        if first or moment.step % self._period == 0:
            self._samples.append((moment.step, self._measurement.measure(moment)))
        self.fresh = first
        while len(self._samples) > 1 and self._samples[1][0] + self._delay <= moment.step:
            self._samples.popleft()
            self.fresh = True
        return self._samples[0][1]

    def state(self) -> bytes:
        """Return the samples on their way and the measurement's own memory."""
        arrays = {f"memory.{key}": value for key, value in self._measurement.memory().items()}
        arrays["steps"] = np.array([step for step, _ in self._samples], dtype=np.int64)
        if self._samples:
            arrays["samples"] = np.stack([sample for _, sample in self._samples])
        return pack(arrays)

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        arrays = unpack(state)
        steps = arrays.pop("steps").tolist()
        samples = arrays.pop("samples") if steps else ()
        self._samples = deque(zip(steps, samples, strict=True))
        self._measurement.remember(
            {key.removeprefix("memory."): value for key, value in arrays.items()}
        )
        self.fresh = False
