"""Verifying a run: its files first, and then some of its trials once more.

Which trials run again cannot be predicted.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.errors import StoreError, UsageError
from nw_eval.api.paths import as_path
from nw_eval.api.renamed import keywords_were
from nw_eval.engine.how import How

if TYPE_CHECKING:
    from os import PathLike

    from nw_gate.results.evidence_check import CheckedFiles
    from nw_sim.rollout.replaying.reports import Repeats

SAMPLE = "5%"
"""Of the trials with a result that run again, where nothing else is asked for."""


@dataclass(frozen=True, kw_only=True)
class VerifiedRun:
    """A run that was looked at, and of which trials were run again."""

    folder: Path
    files: CheckedFiles
    """Whether its files are as they were."""
    repeats: Repeats | None
    """Trials that were run again; None where none was asked for."""
    ladders: tuple[VerifiedRun, ...] = ()
    """The same of its runs on ladders."""

    @property
    def is_as_it_was(self) -> bool:
        """Whether nothing speaks against rows and logs."""
        again = () if self.repeats is None else self.repeats.trials
        own = not self.files.findings and all(each.is_identical for each in again)
        return own and all(each.is_as_it_was for each in self.ladders)

    @property
    def interrupted(self) -> bool:
        """Whether a signal ended it before its last trial."""
        own = self.repeats is not None and self.repeats.interrupted
        return own or any(each.interrupted for each in self.ladders)

    @property
    def exit_code(self) -> int:
        """0 verified, 4 something is not as it was, 5 (or 2) trials cannot be run again here."""
        if not self.is_as_it_was:
            return StoreError.exit_code
        if self.repeats is not None and self.repeats.unable is not None:
            return self.repeats.unable.exit_code
        return max([each.exit_code for each in self.ladders], default=0)


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
    checkpoint: str | PathLike[str] | None = None,
    allow_code: bool = False,
    **how: Any,
) -> VerifiedRun:
    """Say whether rows and logs of a run are as they were, and whether trials give them again.

    Nothing is written into the run's folder.

    Args:
        run: the folder of a run, finished, unfinished or interrupted.
        offline: check the files only; re-run nothing.
        trials: how many trials to re-run, or which share of them, such as `5%`; at least one
            (default: 5%).
        seed: the seed that an earlier verification printed, to draw the same trials (default:
            random).
        root: the Merkle root that the run ended with, if you kept it elsewhere.
        policy: the policy, if it moved or is served elsewhere.
        checkpoint: the checkpoint that replaced the card's, if it moved.
        allow_code: whether Python code that the policy's card names may be imported.
        how: fields of `How` by name: workers, listener.

    Raises:
        UsageError: it is not a run folder, or an argument is invalid.
        StoreError: its run.json is damaged, or contradicts itself.
    """
    from nw_eval.api.saved_run import saved_suite, saved_trials
    from nw_eval.engine.order import check_sample, unforeseen_seed
    from nw_gate.results.evidence_check import check_files
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.request import Request
    from nw_gate.results.run_folder import RunFolder, open_run_folder

    checkpoint = as_path(checkpoint)
    means = How.of(how, "workers", "listener")
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
        from nw_eval.api.verifying_trials import run_again

        repeats = run_again(
            folder,
            info,
            rows,
            Request.of(None, policy=policy, checkpoint=checkpoint, allow_code=allow_code),
            sample=sample,
            seed=unforeseen_seed() if seed is None else seed,
            how=means,
        )
    verified = VerifiedRun(folder=folder.path, files=files, repeats=repeats)
    if verified.interrupted:
        return verified
    ladders = tuple(
        verify(
            nested.path,
            offline=offline,
            trials=trials,
            seed=seed,
            # Beside the candidate's run may be one of the baseline's policy, which lies elsewhere.
            policy=policy if nested.path.name == "candidate" else None,
            checkpoint=checkpoint if nested.path.name == "candidate" else None,
            allow_code=allow_code,
            **how,
        )
        for nested in folder.limit_runs
    )
    return replace(verified, ladders=ladders)


def _of_another_root(files: CheckedFiles, root: str) -> CheckedFiles:
    from nw_gate.results.evidence_check import Discrepancy

    about = f"merkle_root is {files.root[:12] or 'missing'}, not {root[:12]}"
    finding = Discrepancy(what="changed", file="run.json", about=about)
    return replace(files, findings=(finding, *files.findings))
