"""What a run's logs showed, kept for the next run that has the very same logs.

To read 160 logs takes two seconds, and a run that takes its trials over from earlier ones has their
logs, too. So what the reading processes said is kept in the user's cache, under a digest of all
that it depends on: each log's bytes and what of it was wanted, this program and its libraries. And
the policy: logs are written by processes that its checkpoint may have taken over, and what one log
makes its reader say of the others is said again of the same policy's logs alone.

Nothing in a file is believed before its seal has been compared; what is damaged, or another's, is
none. The files of most runs have a megabyte, and the oldest go first.
"""

from __future__ import annotations

import stat
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Self

from pydantic import ValidationError

from nw_eval.api.running.evidence.content import ReadLog, ReadLogs
from nw_eval.errors import StoreError
from nw_eval.files.cache import DamagedError, private_dir, read_sealed, sealed_path
from nw_eval.results.evidence import log_sha256
from nw_eval.results.machine import code_info
from nw_eval.suite.digest import digest_of

if TYPE_CHECKING:
    from nw_eval.api.running.evidence.apart import WantedLog
    from nw_eval.results.provenance import RunInfo

_FORMAT = 1
_LIBRARIES = ("numpy", "pillow")
"""That pictures are made with; whoever has other ones makes other bytes."""
_MOST_FILE = 2**26
"""Bytes of a file that is read."""
_MOST = 2**26
"""Bytes of all of them."""


@dataclass(frozen=True, kw_only=True)
class KeptEvidence:
    """What was kept for the runs of one policy."""

    folder: Path
    """Into which only this user can write."""
    policy: tuple[str, str]
    """Hex digests of card and checkpoint."""

    @classmethod
    def of_run(cls, run: RunInfo) -> Self | None:
        """Return what there is for a run of this machine; None if it does without the cache."""
        if run.cache is None or run.cache.off:
            return None
        try:
            folder = private_dir("evidence")
        except StoreError:  # The run has said already that nothing can be kept.
            return None
        return cls(folder=folder, policy=(run.policy.card_digest, run.policy.checkpoint_digest))

    def key(self, wanted: Sequence[WantedLog], room: Mapping[str, int]) -> str:
        """Return the hex digest of what reading logs depends on; empty if one cannot be read.

        Args:
            wanted: logs, and what of them is wanted, in order.
            room: bytes that pictures may have.
        """
        with ThreadPoolExecutor() as pool:  # Hashing holds no lock.
            sums = list(pool.map(log_sha256, [log.path for log in wanted]))
        if not all(sums):
            return ""
        makers = [code_info().digest, *map(version, _LIBRARIES)]
        logs = [[each, log.scene, log.clip] for each, log in zip(sums, wanted, strict=True)]
        return digest_of([_FORMAT, makers, self.policy, dict(room), logs])

    def find(self, key: str) -> tuple[ReadLog, ...] | None:
        """Return what is kept under a key, in the order of its logs; None if nothing is."""
        path = self.folder / key
        try:
            facts = path.lstat()
            if not stat.S_ISREG(facts.st_mode) or facts.st_size > _MOST_FILE:
                return None
            name, _, content = bytes(read_sealed(path)).partition(b"\n")
            logs = ReadLogs.model_validate_json(content).logs
            path.touch()
        except (OSError, DamagedError, ValidationError):
            return None
        return logs if name == key.encode() else None

    def keep(self, key: str, logs: Sequence[ReadLog]) -> None:
        """Keep what logs show, but not what kept one from being read: that may not last."""
        if not key or any(log.fault or log.unseen for log in logs):
            return
        content = ReadLogs(logs=tuple(logs)).model_dump_json()
        with suppress(StoreError), sealed_path(self.folder / key) as path:
            path.write_text(f"{key}\n{content}", encoding="utf-8")
        self._prune()

    def _prune(self) -> None:
        """Remove the files that were not used for longest, until there is room for the rest."""
        with suppress(OSError):
            found = [(path, path.lstat()) for path in self.folder.iterdir()]
            room = _MOST
            for path, facts in sorted(found, key=lambda each: -each[1].st_mtime_ns):
                room -= facts.st_size
                if room < 0:
                    path.unlink()
