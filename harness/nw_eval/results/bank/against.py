"""The bank that a run is compared with, and what the run says of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from nw_eval.results.bank.start import SavedBank
from nw_eval.results.provenance import BaselineInfo, RunInfo
from nw_eval.results.row import Row


@dataclass(frozen=True, kw_only=True)
class ControlArm:
    """Trials of the bank's own policy that ran beside the candidate, from the same starts."""

    run: RunInfo
    rows: tuple[Row, ...]


@dataclass(frozen=True, kw_only=True)
class Against:
    """The bank that a run is compared with."""

    info: BaselineInfo
    bank: SavedBank
    content: bytes
    """Of its file, of which the run's folder gets a copy."""
    control: ControlArm | None = None
    """None where the bank says what its policy does on the machine of the run."""

    def of_run(self, info: BaselineInfo) -> Against:
        """Return the bank as a run knows it, that was begun with it somewhere else."""
        return replace(self, info=info.model_copy(update={"checked": None, "moved": ()}))
