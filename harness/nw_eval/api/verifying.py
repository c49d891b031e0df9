"""Verifying a run: its files first, and then some of its trials once more.

Which trials run again cannot be predicted.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from nw_eval.api.renamed import keywords_were
from nw_eval.errors import NwEvalError, StoreError, UsageError

if TYPE_CHECKING:
    from nw_eval.engine.listener import Listener
    from nw_eval.results.evidence_check import CheckedFiles
    from nw_eval.rollout.replaying.reports import Difference

SAMPLE = "5%"
"""Of the trials with a result that run again, where nothing else is asked for."""

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


_ROOT = re.compile(r"[0-9a-f]{64}")


@keywords_were(sample="trials")
def verify(
    run: str | Path,
    *,
    offline: bool = False,
    trials: str | int = SAMPLE,
    seed: int | None = None,
    root: str | None = None,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    workers: int | None = None,
    listener: Listener | None = None,
) -> VerifiedRun:
    """Say whether rows and logs of a run are as they were, and whether trials give them again.

    Nothing is written into the run's folder.

    Args:
        run: the run's folder; it may go on, or have been interrupted.
        offline: look at its files only, and run nothing.
        trials: how many of those with a result are run again: a share such as `5%`, or a number.
            At least one is.
        seed: draws them; one that cannot be predicted if None.
        root: the Merkle root that the run had, kept elsewhere.
        policy: the bundle that made it, where it has moved since, or is served elsewhere.
        checkpoint: weights that were used instead of the card's, where they have moved since.
        allow_code: whether Python code that the policy's card names may be imported.
        workers: processes; one for each core if None.
        listener: hears of progress.

    Raises:
        UsageError: it is no run's folder, or an argument is of no use.
        StoreError: its run.json is damaged, or contradicts itself.
    """
    from nw_eval.api.plans import check_workers
    from nw_eval.api.saved_run import saved_suite, saved_trials
    from nw_eval.request import Request
    from nw_eval.results.evidence_check import check_files
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.run_folder import RunFolder, open_run_folder

    check_workers(workers)
    sample = str(trials)
    check_sample(sample)
    if root is not None and not _ROOT.fullmatch(root):
        raise UsageError(f"--root {root!r} is no Merkle root", fix="give its 64 hex digits")
    folder = RunFolder(path=open_run_folder(Path(run)).path.resolve())
    info = read_run_info(folder.run_json)
    planned = {trial.id for trial in saved_trials(info, saved_suite(info))}
    files, rows = check_files(folder, info, planned)
    if root not in {None, info.merkle_root}:
        files = _of_another_root(files, root or "")
    repeats = None
    if not offline:
        from nw_eval.api.verifying_again import run_again

        repeats = run_again(
            folder,
            info,
            rows,
            Request.of(None, policy=policy, checkpoint=checkpoint, allow_code=allow_code),
            sample=sample,
            seed=unforeseen_seed() if seed is None else seed,
            workers=workers,
            listener=listener,
        )
    return VerifiedRun(folder=folder.path, files=files, repeats=repeats)


def _of_another_root(files: CheckedFiles, root: str) -> CheckedFiles:
    from nw_eval.results.evidence_check import Discrepancy

    about = f"merkle_root is {files.root[:12] or 'missing'}, not {root[:12]}"
    finding = Discrepancy(what="changed", file="run.json", about=about)
    return replace(files, findings=(finding, *files.findings))


_BITS = 48  # of a seed, which somebody may have to type
_SHARE = re.compile(r"([0-9]{1,3}(?:\.[0-9]{1,9})?) ?%|([0-9]{1,9})")


def unforeseen_seed() -> int:
    """Return a seed that was not known before."""
    return secrets.randbits(_BITS)


def draw(trials: Collection[str], sample: str, seed: int) -> tuple[str, ...]:
    """Return the trials that a seed draws, sorted: the same ones whatever their order was.

    Args:
        trials: ids.
        sample: as `check_sample`.
        seed: of the draw.
    """
    count = min(max(1, _count(sample, len(trials))), len(trials))
    ranked = sorted(trials, key=lambda name: sha256(f"{seed}/{name}".encode()).digest())
    return tuple(sorted(ranked[:count]))


def check_sample(sample: str, option: str = "--trials") -> None:
    """Refuse what is neither a share, such as `5%`, nor a number of trials.

    Args:
        sample: the words.
        option: what they were given for.

    Raises:
        UsageError: it is not.
    """
    found = _SHARE.fullmatch(sample)
    if found is None or not 0.0 < float(found[1] or found[2]) <= (100.0 if found[1] else 1e9):
        raise UsageError(
            f"{option} {sample!r} is no share of the trials and no number of them",
            fix="give one, such as 5% or 3",
        )


def _count(sample: str, of: int) -> int:
    if sample.endswith("%"):
        return ceil(float(sample.rstrip(" %")) / 100.0 * of)
    return int(sample)
