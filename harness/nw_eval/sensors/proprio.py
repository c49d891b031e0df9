"""Proprioception: terms, scaled, joined, selected and stacked as the card says."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import PolicyError
from nw_eval.policies.card import Command
from nw_eval.policies.control import JointControl
from nw_eval.policies.observations import ProprioObservation, selected_indices
from nw_eval.policies.terms import AnyTerm, term_size
from nw_eval.sensors.history import HistoryStack
from nw_eval.sensors.sensor import Moment
from nw_eval.sensors.terms import reader


class Proprio:
    """Numbers of the body, (n,) float32."""

    unit = "mixed"
    is_image = False
    coverage = None

    def __init__(
        self, name: str, observation: ProprioObservation, command: Command, control: JointControl
    ) -> None:
        """Prepare one reader for each term.

        Raises:
            PolicyError: a list of scales has another length than its term, or `select` names
                numbers that the frame does not have.
        """
        joints = len(control.order)
        terms = observation.frame_terms
        sizes = [term_size(term, joints) for term in terms]
        bounds = np.cumsum([0, *sizes]).tolist()
        self._readers = [
            (slice(a, b), reader(term, command, control))
            for term, a, b in zip(terms, bounds[:-1], bounds[1:], strict=True)
        ]
        self._scale = np.concatenate(
            [_scales(name, t, n) for t, n in zip(terms, sizes, strict=True)]
        )
        self._offset = np.repeat([term.offset for term in terms], sizes)
        # Columns low, high; None where nothing is limited, since clipping costs more than reading.
        limits = [term.clip or (-np.inf, np.inf) for term in terms]
        self._limits = np.repeat(limits, sizes, axis=0) if any(t.clip for t in terms) else None
        self._clip = observation.clip
        self._keep = _kept(name, observation, bounds[-1])
        self._history = None
        self.frame_sizes = sizes if self._keep is None else [len(self._keep)]
        self.shape: tuple[int, ...] = (sum(self.frame_sizes),)
        self.dtype = np.dtype(np.float32)
        if observation.history is not None:
            self._history = HistoryStack(observation.history, self.frame_sizes)
            self.shape = (self._history.size,)
        self._frame = np.zeros(bounds[-1])

    def reset(self) -> None:
        """Forget earlier frames."""
        if self._history is not None:
            self._history.reset()

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Return the present frame, or the stack that it completes."""
        frame = self._frame
        for part, read in self._readers:
            frame[part] = read(moment)
        if self._limits is not None:
            np.clip(frame, self._limits[:, 0], self._limits[:, 1], out=frame)
        scaled = frame * self._scale + self._offset
        if self._clip is not None:
            np.clip(scaled, *self._clip, out=scaled)
        if self._keep is not None:
            scaled = scaled[self._keep]
        single = scaled.astype(np.float32)
        return single if self._history is None else self._history.push(single)

    def memory(self) -> dict[str, NDArray[Any]]:
        """Return the earlier frames."""
        return {} if self._history is None else {"frames": self._history.frames}

    def remember(self, memory: dict[str, NDArray[Any]]) -> None:
        """Go back to earlier frames."""
        if self._history is not None:
            self._history.frames = memory["frames"]


def _scales(name: str, term: AnyTerm, size: int) -> NDArray[np.float64]:
    if isinstance(term.scale, list) and len(term.scale) != size:
        raise PolicyError(
            f"`{name}`: term {term.term} has {size} numbers but {len(term.scale)} scales",
            fix="give one scale, or one for each number",
        )
    return np.broadcast_to(np.asarray(term.scale, dtype=np.float64), size).copy()


def _kept(name: str, observation: ProprioObservation, size: int) -> NDArray[np.intp] | None:
    if observation.select is None:
        return None
    try:
        return np.array(selected_indices(observation.select, size), dtype=np.intp)
    except ValueError as error:
        raise PolicyError(f"`{name}`: {error}") from None
