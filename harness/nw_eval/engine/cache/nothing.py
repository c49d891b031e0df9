"""A run without the cache of trials."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.results.provenance import CacheInfo

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.results.row import Row
    from nw_eval.rollout.job import TrialJob


class NothingKnown:
    """Knows no trial and keeps none: every job runs. In place of a `KnownTrials`.

    Args:
        why: the cache is not used.
    """

    def __init__(self, why: str = "") -> None:
        self.info = CacheInfo(off=why)

    def to_run(self, jobs: Sequence[TrialJob]) -> list[TrialJob]:
        """Return all jobs."""
        return list(jobs)

    def ended(self, job: TrialJob, row: Row) -> None:
        """Forget it."""

    def agreed(self, *, at_last: bool = False) -> list[Row]:  # noqa: ARG002 - nothing waits.
        """Return nothing."""
        return []

    def unconfirmed(self) -> list[TrialJob]:
        """Return nothing."""
        return []
