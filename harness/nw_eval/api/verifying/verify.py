"""Verifying a run: its files first, and then some of its trials once more."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.api.verifying.result import VerifiedRun
from nw_eval.api.verifying.sample import SAMPLE
from nw_eval.errors import UsageError

if TYPE_CHECKING:
    from nw_eval.engine.listener import Listener
    from nw_eval.results.evidence_check import CheckedFiles

_ROOT = re.compile(r"[0-9a-f]{64}")


def verify(
    run: str | Path,
    *,
    offline: bool = False,
    sample: str = SAMPLE,
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
        sample: how many trials with a result are run again: a share such as `5%`, or a number. At
            least one is.
        seed: draws them; one that nobody can foresee if None.
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
    from nw_eval.api.running.plans import check_workers
    from nw_eval.api.running.saved_run import saved_suite, saved_trials
    from nw_eval.api.verifying.sample import check_sample, unforeseen_seed
    from nw_eval.request import Request
    from nw_eval.results.evidence_check import check_files
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.run_folder import RunFolder, open_run_folder

    check_workers(workers)
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
        from nw_eval.api.verifying.again import run_again

        repeats = run_again(
            folder,
            info,
            {name: row for name, row in rows.items() if name in planned},
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
