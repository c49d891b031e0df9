"""What verifying a run came to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from nw_eval.errors import NwEvalError, StoreError

if TYPE_CHECKING:
    from nw_eval.results.evidence_check import CheckedFiles
    from nw_eval.rollout.replaying.report import Difference

Kind = Literal["state", "action", "observation", "image", "other"]
"""Of what a log holds."""


@dataclass(frozen=True, kw_only=True)
class RepeatedTrial:
    """A trial of the run that was run again."""

    trial: str
    steps: int
    """Control steps that it has now."""
    differences: tuple[Difference, ...]
    """Columns of its row that are others now, the digests of states and actions among them."""
    partings: Mapping[Kind, int]
    """The control step, from 0, from which on its log holds others: its images, say."""
    log: Literal["same", "compared", "gone"]
    """The log has the same bytes; or was compared message by message; or cannot be compared."""
    fault: str = ""
    """Why it came to no result now, if it did not."""

    @property
    def is_identical(self) -> bool:
        """Whether all that was compared is the same, bit for bit."""
        return not (self.fault or self.differences or self.partings)


@dataclass(frozen=True, kw_only=True)
class Repeats:
    """Trials of a run that were run again."""

    seed: int
    """What drew them."""
    of: int
    """How many trials with a result they were drawn from."""
    trials: tuple[RepeatedTrial, ...] = ()
    unable: NwEvalError | None = None
    """Why none could be run again, or compared."""
    interrupted: bool = False


@dataclass(frozen=True, kw_only=True)
class VerifiedRun:
    """A run that was looked at, and of which trials were run again."""

    folder: Path
    files: CheckedFiles
    """Whether its files are as they were."""
    repeats: Repeats | None
    """Trials that were run again; None where none was asked for."""

    @property
    def is_as_it_was(self) -> bool:
        """Whether nothing speaks against rows and logs."""
        again = () if self.repeats is None else self.repeats.trials
        return not self.files.findings and all(each.is_identical for each in again)

    @property
    def interrupted(self) -> bool:
        """Whether a signal ended it before its last trial."""
        return self.repeats is not None and self.repeats.interrupted

    @property
    def exit_code(self) -> int:
        """0 verified, 4 something is not as it was, 5 (or 2) trials cannot be run again here."""
        if not self.is_as_it_was:
            return StoreError.exit_code
        if self.repeats is not None and self.repeats.unable is not None:
            return self.repeats.unable.exit_code
        return 0
