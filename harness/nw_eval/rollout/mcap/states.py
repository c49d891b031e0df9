"""What is noted of restartable states until they are written."""

from __future__ import annotations

from nw_eval.rollout.mcap.batch import Channels, Part, records
from nw_eval.rollout.mcap.content.sim_state import Saved, sim_state
from nw_eval.rollout.mcap.messages import SimState
from nw_eval.rollout.mcap.wire import time_field


class States:
    """Notes of restartable states."""

    def __init__(self) -> None:
        self._notes: list[tuple[int, Saved]] = []

    def note(self, time_ns: int, saved: Saved) -> None:
        """Keep a state."""
        self._notes.append((time_ns, saved))

    def take(self, channels: Channels) -> list[Part]:
        """Return the messages of all notes so far, and forget them."""
        notes, self._notes = self._notes, []
        times = [time_ns for time_ns, _ in notes]
        messages = (time_field(time_ns) + sim_state(saved) for time_ns, saved in notes)
        numbers = [channels("/nw/state", SimState)] * len(notes)
        return [(range(len(notes)), records(numbers, times, messages))]
