"""A restartable state as an `nw.SimState` message, put together by hand: it has a dozen parts.

States are noted as they are until they are written.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

from nw_eval.rollout.mcap.batch import Channels, Part, records
from nw_eval.rollout.mcap.messages import SimState, sized, time_field, varint

# Fields of `SimState` and of its `Part`s, as in `messages._MESSAGES`.
_STEP, _WORLD, _POLICY, _PART = b"\x10", b"\x1a", b"\x22", b"\x2a"
_NAME, _DATA = b"\x0a", b"\x12"
# Bytes before the data of a part at most, beside its name.
_MOST_HEAD = 24


class Saved(NamedTuple):
    """What a trial needs to go on from a control step; see `messages` for each."""

    step: int
    world: bytes
    policy: bytes
    parts: Mapping[str, bytes]

    @property
    def size(self) -> int:
        """Bytes of the data in it."""
        return len(self.world) + len(self.policy) + sum(map(len, self.parts.values()))

    def exceeds(self, size: int) -> bool:
        """Whether its message has more bytes than that without a time, counted where it may."""
        heads = 4 * sum(map(len, self.parts)) + _MOST_HEAD * (len(self.parts) + 3)
        return self.size + heads > size and len(sim_state(self)) > size


def sim_state(saved: Saved) -> bytes:
    """Return the message without its time; what is zero or empty is left out, as protobuf does."""
    found: list[bytes] = []
    if saved.step:
        found += _STEP, varint(saved.step)
    for field, data in ((_WORLD, saved.world), (_POLICY, saved.policy)):
        if data:
            found += field, sized(data)
    for name, data in saved.parts.items():
        found += _part_head(name, len(data)), data
    return b"".join(found)


@lru_cache(maxsize=1024)  # They are the same in most states.
def _part_head(name: str, size: int) -> bytes:
    """Return what stands before the data of a part."""
    found = _NAME + sized(name.encode()) if name else b""
    if size:
        found += _DATA + varint(size)
    return _PART + varint(len(found) + size) + found


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
