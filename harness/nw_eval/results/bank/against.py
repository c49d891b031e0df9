"""The bank that a run is compared with, and what the run says of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from nw_eval.results.bank.start import SavedBank
from nw_eval.results.provenance import BaselineInfo


@dataclass(frozen=True, kw_only=True)
class Against:
    """The bank that a run is compared with."""

    info: BaselineInfo
    bank: SavedBank
    content: bytes
    """Of its file, of which the run's folder gets a copy."""

    def of_run(self, info: BaselineInfo) -> Against:
        """Return the bank as a run knows it, that was begun with it somewhere else."""
        return replace(self, info=info.model_copy(update={"checked": None, "moved": ()}))
