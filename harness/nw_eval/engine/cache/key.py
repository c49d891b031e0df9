"""What a result depends on, as one digest: bytes and numbers, and never a name."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from nw_eval.suite.digest import digest_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nw_eval.rollout.job import TrialJob

FORMAT = 1
"""Of an entry. Those of another one are found by nobody, and go as they grow old."""

# What names things, and what says where a trial runs, how long it may take, and where its log goes.
# Every other field counts, those that are added too. Scene, policy and checkpoint count by their
# digests.
_LABELS = frozenset({"suite", "scene", "tier", "place"})
_CIRCUMSTANCE = frozenset(
    {"trial", "scene", "policy", "policy_name", "checkpoint"}
    | {"allow_code", "attachments", "mcap", "time_limit"}
)


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What all trials of a run have in common that can change a result.

    Attributes:
        policy: hex digest of card and weights, `Bundle.digest`.
        engine: `JournalHeader.engine`: versions, renderer, kind of CPU, code.
        system: what else lies beneath them, such as the C library's version.
    """

    policy: str
    engine: Mapping[str, str]
    system: Mapping[str, str]

    @cached_property
    def digest(self) -> str:
        """Hex sha256. Entries of one digest lie in one folder, and are voided together."""
        return digest_of([FORMAT, self.policy, dict(self.engine), dict(self.system)])

    def key(self, job: TrialJob) -> str:
        """Return the hex sha256 of everything that can change a trial's result, or its log."""
        trial = _without(vars(job.trial), _LABELS | {"identity"})  # It is a digest of the others.
        return digest_of([self.digest, trial, _without(vars(job), _CIRCUMSTANCE)])


def system() -> dict[str, str]:
    """Return what numerical libraries stand on, beside the processor."""
    return {
        "python": platform.python_version(),
        "libc": " ".join(platform.libc_ver()),
        "architecture": platform.machine(),
    }


def _without(fields: Mapping[str, Any], names: frozenset[str]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if name not in names}
