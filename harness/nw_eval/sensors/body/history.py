"""From the present frame of the body's numbers to what the policy sees: parts, and a past."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations import History
from nw_eval.memory import Arrays
from nw_eval.sensors.wrappers.wrapper import Plain, Shot

Frame = NDArray[np.float32]
Indices = NDArray[np.intp]

# The published evaluation keeps ten frames, and spoils the first two observations (see below).
_PUBLISHED_FRAMES = 10
_SPOILT_STEPS = 1


class Select(Plain):
    """Some numbers of each frame.

    Args:
        keep: which; None = all.
        spoils: whether the first observation is that of the published evaluation: each number of
            the frame stands eleven times in a row there, so that the present frame holds only its
            first five numbers.
    """

    def __init__(self, keep: Indices | None, *, spoils: bool) -> None:
        self._keep = keep
        self._spoils = spoils

    def __call__(self, sample: Frame, shot: Shot) -> Frame:
        """Return the numbers that are kept."""
        if self._spoils and shot.step <= _SPOILT_STEPS:
            sample = spoilt_frames(sample)[0]
        return sample if self._keep is None else sample[self._keep]


class HistoryStack:
    """The last frames of an observation, flattened as its checkpoint was trained to read them.

    Args:
        history: how many frames, in which order.
        sizes: how many numbers each term of a whole frame has.
        keep: which numbers of a frame the stack holds; None = all.
        zero: which of those read 0 once they are history.
        spoils: as in `Select`; of histories that are longer than the published one, nothing.
    """

    def __init__(
        self,
        history: History,
        sizes: Sequence[int],
        *,
        keep: Indices | None = None,
        zero: Indices | None = None,
        spoils: bool = False,
    ) -> None:
        self._history = history
        bounds = np.cumsum([0, *sizes]).tolist()
        self._terms = [slice(a, b) for a, b in pairwise(bounds)]
        self._keep = keep
        self._zero = zero
        earlier = history.steps - history.current
        self._spoils = spoils and earlier <= _PUBLISHED_FRAMES
        # Frames before the present one, oldest first, whatever the order of the output.
        self._frames: list[Frame] = []

    def __call__(self, sample: Frame, shot: Shot) -> Frame:
        """Add the present frame and return the stack, (n,) float32."""
        history = self._history
        # In memory of its own: it is kept, and the sample is seen by others.
        frame = sample.copy() if self._keep is None else sample[self._keep]
        past = frame
        if self._zero is not None:
            past = frame.copy()
            past[self._zero] = 0.0
        frames = self._frames
        if not frames:
            filler = past if history.start == "repeat" else np.zeros_like(past)
            frames = [filler] * history.steps
        shown = [*frames[1:], frame] if history.current else frames
        self._frames = [*frames[1:], past]
        if self._spoils and shot.step <= _SPOILT_STEPS:
            shown = self._spoilt(sample)
        if history.order == "newest_first":
            shown = shown[::-1]
        if history.by == "term":
            return np.concatenate([frame[term] for term in self._terms for frame in shown])
        return np.concatenate(shown)

    def reset(self, rng: np.random.Generator) -> None:  # noqa: ARG002 - nothing here is random.
        """Forget all frames."""
        self._frames = []

    def state(self) -> Arrays:
        """Return the earlier frames."""
        return {"frames": np.array(self._frames)} if self._frames else {}

    def restore(self, state: Arrays) -> None:
        """Go back to earlier frames.

        Raises:
            ValueError: they are those of another history.
        """
        frames = state.get("frames")
        if frames is not None and (len(frames), frames.dtype) != (self._history.steps, np.float32):
            raise ValueError(f"a history of {frames.shape} {frames.dtype}")
        self._frames = [] if frames is None else list(frames)

    def _spoilt(self, frame: Frame) -> list[Frame]:
        """Return frames of the published first observation, oldest first."""
        present, *past = spoilt_frames(frame)
        shown = [*past, present] if self._history.current else past
        shown = shown[len(shown) - self._history.steps :]
        return shown if self._keep is None else [frame[self._keep] for frame in shown]


def spoilt_frames(frame: Frame) -> Frame:
    """Return the frames of the published first observation, (11, n): the present, then the past.

    The published wrapper repeats every number eleven times where it means to repeat the frame:
    flat number i is frame[i // 11].
    """
    count = _PUBLISHED_FRAMES + 1
    return np.repeat(frame, count).reshape(count, len(frame))
