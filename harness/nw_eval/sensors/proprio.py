"""Numbers of the body, scaled and joined as the card says, their past; and the way to go."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.card import Command
from nw_eval.cards.joint_control import JointControl
from nw_eval.cards.observations import (
    DirectionObservation,
    History,
    ProprioObservation,
    selected_indices,
)
from nw_eval.cards.terms import AnyTerm, Constant, term_size
from nw_eval.errors import PolicyError
from nw_eval.memory import Arrays, read_only
from nw_eval.sensors.sensor import Measurement, Plain, Shot, StepContext
from nw_eval.sensors.terms import Reader, reader

Frame = NDArray[np.float32]
Indices = NDArray[np.intp]

# The published evaluation keeps ten frames, and spoils the first two observations (see below).
_PUBLISHED_FRAMES = 10
_SPOILT_STEPS = 1


class Proprio(Measurement):
    """Numbers of the body at this moment: one whole frame, (n,) float32.

    What the card takes of a frame, and its history, are its `form`.
    """

    unit = "mixed"

    def __init__(
        self,
        name: str,
        observation: ProprioObservation,
        command: Command,
        control: JointControl,
        feet: Sequence[str],
        *,
        spoils_first: bool = False,
    ) -> None:
        """Prepare one reader for each term.

        Args:
            name: of the observation, for errors.
            observation: from the card.
            command: the card's.
            control: the card's.
            feet: the robot's.
            spoils_first: whether the protocol spoils the first observation of its own 53 numbers.

        Raises:
            PolicyError: a list of scales has another length than its term, or `select` or `zero`
                name numbers that the frame does not have, or a term a foot that the robot has not.
        """
        terms = observation.frame_terms
        self._name = name
        self._observation = observation
        self._sizes = [term_size(term, control.names) for term in terms]
        bounds = np.cumsum([0, *self._sizes]).tolist()
        # Everything that never changes is written once.
        self._frame = np.zeros(bounds[-1])
        self._readers: list[tuple[slice, Reader]] = []
        for term, a, b in zip(terms, bounds[:-1], bounds[1:], strict=True):
            if isinstance(term, Constant):
                self._frame[a:b] = term.values
            else:
                self._readers.append((slice(a, b), reader(term, command, control, feet)))
        scale = np.concatenate(
            [_scales(name, t, n) for t, n in zip(terms, self._sizes, strict=True)]
        )
        self._scale = scale if (scale != 1.0).any() else None
        offset = np.repeat([term.offset for term in terms], self._sizes)
        self._offset = offset if offset.any() else None
        # Columns low, high; None where nothing is limited, since clipping costs more than reading.
        limits = [term.clip or (-np.inf, np.inf) for term in terms]
        limited = any(t.clip for t in terms)
        self._limits = np.repeat(limits, self._sizes, axis=0) if limited else None
        self._clip = observation.clip
        self._keep = _indices(name, observation.select, bounds[-1])
        self._kept_sizes = self._sizes if self._keep is None else [len(self._keep)]
        self.shape: tuple[int, ...] = (bounds[-1],)
        self.dtype = np.dtype(np.float32)
        self.form = self._form(spoils=spoils_first and observation.layout == "parkour53")
        frame = " + ".join(str(size) for size in self._kept_sizes)
        history = observation.history
        self.sum_of = frame if history is None else f"{history.steps} x ({frame})"
        # Observations of one card that have the same terms read them once.
        texts = [one.model_dump_json() for one in (*terms, command)]
        self._key = f"{observation.clip}{texts}"

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Return the present frame."""
        known = moment.shared.get(self._key)
        if known is not None:
            return known
        frame = self._frame
        for part, read in self._readers:
            frame[part] = read(moment)
        if self._limits is not None:
            frame = np.clip(frame, self._limits[:, 0], self._limits[:, 1])
        if self._scale is not None:
            frame = frame * self._scale
        if self._offset is not None:
            frame = frame + self._offset
        if self._clip is not None:
            frame = np.clip(frame, *self._clip)
        single = read_only(frame.astype(np.float32))
        moment.shared[self._key] = single
        return single

    def _form(self, *, spoils: bool) -> list[Select | HistoryStack]:
        """Return what a frame passes through to become the observation."""
        observation, keep = self._observation, self._keep
        if observation.history is not None:
            size = len(keep) if keep is not None else self.shape[0]
            zero = _indices(self._name, observation.history.zero, size)
            sizes = self._kept_sizes
            stack = HistoryStack(observation.history, sizes, keep=keep, zero=zero, spoils=spoils)
            return [stack]
        return [Select(keep, spoils=spoils)] if keep is not None or spoils else []


def _scales(name: str, term: AnyTerm, size: int) -> NDArray[np.float64]:
    if isinstance(term.scale, list) and len(term.scale) != size:
        raise PolicyError(
            f"`{name}`: term {term.term} has {size} numbers but {len(term.scale)} scales",
            fix="give one scale, or one for each number",
        )
    return np.broadcast_to(np.asarray(term.scale, dtype=np.float64), size).copy()


def _indices(name: str, select: list[int | str] | None, size: int) -> NDArray[np.intp] | None:
    if select is None:
        return None
    try:
        return np.array(selected_indices(select, size), dtype=np.intp)
    except ValueError as error:
        raise PolicyError(f"`{name}`: {error}") from None


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


class Direction(Measurement):
    """The angle from the heading to the next waypoint: (1,) rad, or (2,) sine and cosine."""

    def __init__(self, observation: DirectionObservation) -> None:
        self._as_angle = observation.values == "angle"
        self.unit = "rad" if self._as_angle else "1"
        self.shape: tuple[int, ...] = (1,) if self._as_angle else (2,)
        self.dtype = np.dtype(np.float32)

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Read it."""
        angle = moment.delta_yaw
        values = [angle] if self._as_angle else [math.sin(angle), math.cos(angle)]
        return np.array(values, dtype=np.float32)
