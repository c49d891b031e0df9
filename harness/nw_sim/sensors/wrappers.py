"""Wrappers: what a card puts between a sensor and the policy, in order.

Some change numbers one by one, some take images: (H, W) numbers or (H, W, C) colours.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import CodeError, NwEvalError, PolicyError
from nw_base.memory import Arrays
from nw_policies.cards import wrappers
from nw_sim.sensors.plugins import foreign_wrapper
from nw_sim.sensors.sensor import Plain, Sample, Shot, Spec, StepContext, Wrapper

_BYTE = 255

# ITU-R BT.601, as OpenCV and Pillow compute brightness.
_LUMA = np.array([0.299, 0.587, 0.114])


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

    def __call__(self, sample: Sample, moment: StepContext) -> Sample:
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
        self,
        number: int,
        named: NamedWrapper,
        sample: Sample,
        step: int,
        moment: StepContext | None,
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
                fix="check its input with `nw-eval sensors CARD`",
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


def make_wrappers(
    entries: Sequence[wrappers.AnyWrapper], *, code_from: Path | None
) -> list[NamedWrapper]:
    """Return the wrappers of an observation.

    Args:
        entries: from the card.
        code_from: folder beside whose files `module:Class` is looked for; None = no code.

    Raises:
        PolicyError: a plug-in is broken, or code is not allowed.
    """
    return [
        NamedWrapper(name=entry.wrapper, wrapper=_wrapper(entry, code_from)) for entry in entries
    ]


def _wrapper(  # noqa: C901, PLR0912 - one line for each wrapper.
    entry: wrappers.AnyWrapper, code_from: Path | None
) -> Wrapper:
    match entry:
        case wrappers.NoiseWrap():
            return AddNoise(entry)
        case wrappers.Crop():
            return _Function(partial(_cropped, entry))
        case wrappers.Resize():
            return Resize(entry)
        case wrappers.Normalize():
            return _Function(partial(_normalised, entry))
        case wrappers.Scale():
            return _Function(partial(_scaled, entry))
        case wrappers.Clip():
            return _Function(partial(_clipped, entry))
        case wrappers.Grayscale():
            return _Function(_brightness)
        case wrappers.Quantize():
            return _Function(partial(_quantized, entry))
        case wrappers.Stack():
            return Stack(entry.steps, entry.axis)
        case wrappers.Channels():
            return _Function(partial(_in_channels, entry))
        case wrappers.Flatten():
            return _Function(lambda sample: sample.reshape(-1))
        case wrappers.PluginWrap():
            return foreign_wrapper(entry, code_from=code_from)
        case _:
            assert_never(entry)


class AddNoise(Plain):
    """Gaussian errors and lost numbers; a lost pixel of a colour image loses all its colours.

    Args:
        noise: from the card.
        nothing: what a lost number reads unless the card says it.
    """

    def __init__(self, noise: wrappers.Noise, nothing: float = 0.0) -> None:
        self._noise = noise
        lost = nothing if noise.lost is None else noise.lost
        self._lost = np.nan if lost == "nan" else lost

    def __call__(self, sample: Sample, shot: Shot) -> Sample:
        """Draw errors from the trial's stream."""
        noise, rng = self._noise, shot.rng
        values = sample.astype(np.float64)
        if noise.proportional:
            values *= 1.0 + noise.proportional * rng.standard_normal(values.shape)
        if noise.gaussian:
            values += noise.gaussian * rng.standard_normal(values.shape)
        if noise.dropout:
            shape = values.shape[:-1] if is_colour(sample) else values.shape
            values[rng.random(shape) < noise.dropout] = self._lost
        return rounded(values, sample.dtype)


class _Function(Plain):
    """A function of the sample alone, without memory or randomness."""

    def __init__(self, function: Callable[[Sample], Sample]) -> None:
        self._function = function

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return what the function makes of a sample."""
        return self._function(sample)


def _normalised(settings: wrappers.Normalize, sample: Sample) -> Sample:
    """Return (value - mean) / std, float32."""
    mean, std = (np.asarray(each, dtype=np.float32) for each in (settings.mean, settings.std))
    for values in (mean, std):
        if values.ndim and (not sample.ndim or sample.shape[-1] != values.size):
            raise PolicyError(
                f"normalize has {values.size} numbers for a sample of shape {sample.shape}",
                fix="give one, or one for each number along the last axis",
            )
    return (sample.astype(np.float32) - mean) / std


def _scaled(settings: wrappers.Scale, sample: Sample) -> Sample:
    """Return value * scale + offset, float32."""
    return sample.astype(np.float32) * np.float32(settings.scale) + np.float32(settings.offset)


def _clipped(settings: wrappers.Clip, sample: Sample) -> Sample:
    """Return limited values, and something for NaN, of the sample's own type."""
    limited = np.clip(sample, *settings.limits)
    if settings.nan is not None:
        limited = np.where(np.isnan(limited), settings.nan, limited)
    return limited.astype(sample.dtype)


def _quantized(settings: wrappers.Quantize, sample: Sample) -> Sample:
    """Return multiples of a step, halves to the even one, of the sample's own type."""
    values = np.rint(sample.astype(np.float64) / settings.step) * settings.step
    return rounded(values, sample.dtype)


def is_colour(sample: Sample) -> bool:
    """Whether the last axis holds the colours of pixels or the coordinates of points."""
    return sample.ndim >= 3 and sample.shape[-1] == 3


def rounded(values: np.ndarray, dtype: np.dtype) -> Sample:
    """Return values as another type: bytes are rounded and limited, not wrapped around."""
    if dtype == np.uint8:
        values = np.clip(np.rint(values), 0, _BYTE)
    return values.astype(dtype)


_FLAT, _COLOUR = 2, 3


def _cropped(settings: wrappers.Crop, sample: Sample) -> Sample:
    """Return the inner rows and columns."""
    height, width = _size(sample, "crop")
    if settings.top + settings.bottom >= height or settings.left + settings.right >= width:
        raise PolicyError(f"crop leaves nothing of {height} x {width}", fix="cut less off")
    rows = slice(settings.top, height - settings.bottom)
    columns = slice(settings.left, width - settings.right)
    return np.ascontiguousarray(sample[rows, columns])


def _along(weights: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (new, ...) sums of values (old, ...), by the few weights (new, old) that are not 0."""
    most = int(np.count_nonzero(weights, axis=1).max())
    places = np.argsort(weights == 0.0, axis=1, kind="stable")[:, :most]
    shares = np.take_along_axis(weights, places, axis=1)
    total = np.zeros((len(weights), *values.shape[1:]))
    for place, share in zip(places.T, shares.T, strict=True):
        total += share[:, np.newaxis, np.newaxis] * values[place]
    return total


class Resize(Plain):
    """Another size: each axis by a matrix of weights."""

    def __init__(self, settings: wrappers.Resize) -> None:
        self._settings = settings
        self._weights: dict[tuple[int, int], NDArray[np.float64]] = {}

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return (height, width) of the card, with the sample's own type."""
        height, width = _size(sample, "resize")
        settings = self._settings
        if settings.method == "nearest":
            rows, columns = _centres(height, settings.height), _centres(width, settings.width)
            return sample[rows.astype(np.intp)][:, columns.astype(np.intp)]
        down, across = self._matrix(height, settings.height), self._matrix(width, settings.width)
        planes = sample.reshape(height, width, -1).astype(np.float64)
        resized = _along(across, _along(down, planes).swapaxes(0, 1)).swapaxes(0, 1)
        shape = (settings.height, settings.width, *sample.shape[2:])
        return rounded(resized.reshape(shape), sample.dtype)

    def _matrix(self, old: int, new: int) -> NDArray[np.float64]:
        if (old, new) not in self._weights:
            area = self._settings.method == "area"
            self._weights[old, new] = _area(old, new) if area else _bilinear(old, new)
        return self._weights[old, new]


def _brightness(sample: Sample) -> Sample:
    """Return (H, W) of the sample's own type."""
    if sample.ndim != _COLOUR or sample.shape[-1] != len(_LUMA):
        raise PolicyError(
            f"grayscale takes (H, W, 3), not {sample.shape}",
            fix="put it before `channels` and `stack`",
        )
    return rounded(sample @ _LUMA, sample.dtype)


def _in_channels(settings: wrappers.Channels, sample: Sample) -> Sample:
    """Return (C, H, W) or (H, W, C)."""
    _size(sample, "channels")
    if sample.ndim == _FLAT:
        sample = np.repeat(sample[..., np.newaxis], settings.repeat, axis=-1)
    elif settings.repeat > 1:
        raise PolicyError(
            f"channels cannot repeat the colours of {sample.shape}", fix="drop `repeat`"
        )
    first = settings.axis == "first"
    return np.ascontiguousarray(np.moveaxis(sample, -1, 0) if first else sample)


def _size(sample: Sample, wrapper: str) -> tuple[int, int]:
    if sample.ndim not in {_FLAT, _COLOUR}:
        raise PolicyError(
            f"{wrapper} takes an image (H, W) or (H, W, C), not {sample.shape}",
            fix=f"put {wrapper} before `stack` and `flatten`",
        )
    return sample.shape[0], sample.shape[1]


def _centres(old: int, new: int) -> NDArray[np.float64]:
    """Return where the centres of new pixels lie, in old pixels from the left border."""
    return (np.arange(new, dtype=np.float64) + 0.5) * (old / new)


def _area(old: int, new: int) -> NDArray[np.float64]:
    """Return the share (new, old) that each old pixel has of each new one."""
    borders = np.arange(new + 1, dtype=np.float64) * (old / new)
    left = np.maximum(borders[:-1, np.newaxis], np.arange(old))
    right = np.minimum(borders[1:, np.newaxis], np.arange(1, old + 1))
    return np.maximum(right - left, 0.0) * (new / old)


def _bilinear(old: int, new: int) -> NDArray[np.float64]:
    """Return the weights (new, old) of the two old pixels around each new centre."""
    place = np.clip(_centres(old, new) - 0.5, 0.0, old - 1.0)
    lower = np.minimum(place.astype(np.intp), max(old - 2, 0))
    share = place - lower
    weights = np.zeros((new, old))
    rows = np.arange(new)
    weights[rows, lower] += 1.0 - share
    weights[rows, np.minimum(lower + 1, old - 1)] += share
    return weights


class Stack:
    """Samples of this moment and of those before it, oldest first.

    Args:
        steps: how many.
        axis: `first`, `last`: a new axis; `channel`: along the last one.
    """

    def __init__(self, steps: int, axis: Literal["first", "last", "channel"]) -> None:
        self._samples: deque[Sample] = deque(maxlen=steps)
        self._steps = steps
        self._axis = axis

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Add a sample and return all."""
        # The first sample stands for those before it.
        self._samples.extend([sample] * (1 if self._samples else self._steps))
        if self._axis == "channel":
            return np.concatenate(self._samples, axis=-1)
        return np.stack(self._samples, axis=0 if self._axis == "first" else -1)

    def reset(self, rng: np.random.Generator) -> None:  # noqa: ARG002 - nothing here is random.
        """Forget earlier samples."""
        self._samples.clear()

    def state(self) -> Arrays:
        """Return the samples."""
        return {"samples": np.stack(self._samples)} if self._samples else {}

    def restore(self, state: Arrays) -> None:
        """Go back to samples."""
        self._samples.clear()
        if state:
            self._samples.extend(state["samples"])
