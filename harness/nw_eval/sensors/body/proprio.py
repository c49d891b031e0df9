"""Proprioception: terms, scaled and joined as the card says."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.arrays import read_only
from nw_eval.cards.command import Command
from nw_eval.cards.joint_control import JointControl
from nw_eval.cards.observations import ProprioObservation, selected_indices
from nw_eval.cards.terms import AnyTerm, term_size
from nw_eval.errors import PolicyError
from nw_eval.sensors.body.history import HistoryStack, Select
from nw_eval.sensors.body.terms import Reader, fixed_values, reader
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.sensor import Moment


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
        *,
        spoils_first: bool = False,
    ) -> None:
        """Prepare one reader for each term.

        Args:
            name: of the observation, for errors.
            observation: from the card.
            command: the card's.
            control: the card's.
            spoils_first: whether the protocol spoils the first observation of its own 53 numbers.

        Raises:
            PolicyError: a list of scales has another length than its term, or `select` or `zero`
                name numbers that the frame does not have.
        """
        joints = len(control.order)
        terms = observation.frame_terms
        self._name = name
        self._observation = observation
        self._sizes = [term_size(term, joints) for term in terms]
        bounds = np.cumsum([0, *self._sizes]).tolist()
        # Everything that never changes is written once.
        self._frame = np.zeros(bounds[-1])
        self._readers: list[tuple[slice, Reader]] = []
        for term, a, b in zip(terms, bounds[:-1], bounds[1:], strict=True):
            fixed = fixed_values(term, command)
            if fixed is None:
                self._readers.append((slice(a, b), reader(term, command, control)))
            else:
                self._frame[a:b] = fixed
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
        self._key = repr((terms, observation.clip, command))

    def measure(self, moment: Moment) -> NDArray[Any]:
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
