"""What is merged: a part of a run, or a run that was merged before."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.results.provenance import PartInfo, RunInfo
from nw_eval.results.row import Row
from nw_eval.results.run_folder import RunFolder


@dataclass(frozen=True, kw_only=True)
class MergeSource:
    """A folder that is merged, as it was read."""

    folder: RunFolder
    info: RunInfo
    rows: tuple[Row, ...] = ()
    """Of its plan, the latest of each trial."""

    def __str__(self) -> str:
        what = "merged before" if self.info.shard is None else str(self.info.shard)
        return f"{self.folder.path} ({what})"

    @property
    def parts(self) -> tuple[PartInfo, ...]:
        """The parts that it consists of: itself, or those of which it was merged."""
        info = self.info
        if info.shard is None:
            return info.parts
        return (
            PartInfo(
                shard=info.shard,
                id=info.id,
                started=info.started,
                finished=info.finished,
                wall_s=info.wall_s,
                workers=info.workers,
                host=info.machine.host,
                rows_digest=info.rows_digest,
                cache=info.cache,
            ),
        )
