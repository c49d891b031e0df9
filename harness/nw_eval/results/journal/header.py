"""The first line of a journal: what its trials have in common."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

VERSION = 3
_ENCODE = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


@dataclass(frozen=True, kw_only=True)
class JournalHeader:
    """What the trials of one journal have in common: a run may be resumed under the same only.

    `engine` names whatever else makes bits differ, such as `mujoco: 4.0.0` and `renderer: cpu`.
    """

    suite_digest: str
    policy_digest: str
    scene_digests: Mapping[str, str]
    engine: Mapping[str, str] = field(default_factory=dict)

    def differences(self, other: JournalHeader) -> list[str]:
        """Return what differs, in words; scenes that only one of the two has do not count."""
        found: list[str] = []
        for name in ("suite_digest", "policy_digest"):
            old, new = getattr(self, name), getattr(other, name)
            if old != new:
                found.append(f"{name.removesuffix('_digest')} ({old[:8]}, now {new[:8]})")
        for scene in sorted(set(self.scene_digests) & set(other.scene_digests)):
            old, new = self.scene_digests[scene], other.scene_digests[scene]
            if old != new:
                found.append(f"scene {scene} ({old[:8]}, now {new[:8]})")
        for key in sorted(set(self.engine) | set(other.engine)):
            old, new = self.engine.get(key, "none"), other.engine.get(key, "none")
            if old != new:
                found.append(f"{key} ({old}, now {new})")
        return found

    def widened(self, known: Mapping[str, str]) -> JournalHeader:
        """Return this header with scenes that the journal knows already."""
        return replace(self, scene_digests={**known, **self.scene_digests})

    def record(self) -> str:
        """Return the line, without its sum."""
        return _ENCODE({"journal": VERSION, **asdict(self)})


def header_of(record: dict[str, Any]) -> JournalHeader:
    """Return the header that a line's JSON holds.

    Raises:
        ValueError, TypeError, KeyError, AttributeError: it is none, or of another version.
    """
    version = record.pop("journal")
    if version != VERSION:
        raise ValueError(f"journal version {version}, this nw-eval reads {VERSION}")
    texts = (record["suite_digest"], record["policy_digest"])
    tables = (record["scene_digests"], record["engine"])
    values = (*texts, *(text for table in tables for pair in table.items() for text in pair))
    if not all(isinstance(value, str) for value in values):
        raise ValueError("a digest or a version is not text")
    return JournalHeader(**record)
