"""`nw-eval run`: roll a checkpoint out through a suite, and judge it."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from nw_base.words import Engine
from nw_eval.cli.terminal.final_output import tell
from nw_eval.cli.verbs.options import Options, Publishing
from nw_eval.cli.verbs.shared import Label


@dataclass(frozen=True, kw_only=True)
class Run(Publishing, Options):
    """Evaluate a checkpoint on a suite, save the results and print a verdict.

    A suite without a bar (`gate.success_rate`) only runs: its verdict is RAN, exit code 0.
    """

    leaves_verdict: ClassVar = True  # In a file, whatever becomes of the print.

    out: Path | None = None
    """The run's folder (default: `reports/<suite>-<policy>-<time>-<digest>`)."""
    resume: Path | None = None
    """Finish the interrupted run in this folder. Options that are not given keep their values.
    Trials, scenes, record and limits may change; robot, policy, checkpoint, seed, renderer and
    collision may not."""

    label: Label = ()
    ledger: Path | None = None
    """Append the verdict to this ledger (`nw-eval ledger` summarizes it)."""
    in_process: bool = False
    """Run trials in this process, one after another, so that `breakpoint()` works. Only for
    policies that you trust: nothing confines them or stops a hang."""
    no_cache: bool = False
    """Run every trial. By default, results of identical earlier trials are reused, and 2 % of them
    are re-run as a check (`nw-eval cache`)."""

    all_rounds: bool = False
    """Run all trials. By default, a comparison stops when the verdict is decided, and the
    baseline's own policy reuses the baseline's results."""
    engine: Engine = "local"
    """Run trials in processes of this machine (local) or on the nodes of a Ray cluster (ray).
    Results are identical, and --resume may switch."""
    address: str | None = None
    """With --engine ray: auto, host:port of the cluster's head, or ray://host:port (default: start
    a cluster on this machine)."""

    def __call__(self) -> int:
        from nw_base.errors import UsageError
        from nw_eval import api
        from nw_eval.api.ledgers import check_ledger
        from nw_eval.cli.terminal.interruption import INTERRUPTED
        from nw_eval.cli.terminal.progress import RunProgress
        from nw_gate.results.labels import typed_labels

        with self.publishing(str(self.suite or self.resume or "suite")) as judged:
            if self.ledger is not None and self.shard is not None:
                raise UsageError(
                    f"--ledger with --shard {self.shard}: a part has no verdict",
                    fix="give --ledger to `nw-eval merge`",
                )
            if self.ledger is not None:
                check_ledger(self.ledger)
            with (
                group(f"nw-eval run {self.suite or self.resume}", wanted=self.on_github),
                RunProgress(bars=not self.in_process) as progress,
            ):
                judged.run = outcome = api.run(
                    self.request,
                    workers=self.workers,
                    out=self.out,
                    resume=self.resume,
                    in_process=self.in_process,
                    cache=not self.no_cache,
                    all_rounds=self.all_rounds,
                    engine=self.engine,
                    address=self.address,
                    labels=typed_labels(self.label),
                    listener=progress,
                )
            judged.code = outcome.exit_code
            print(self.printed(outcome, judged.code))
            # An interruption that left no trial missing has interrupted nothing.
            if outcome.interrupted and outcome.verdict.verdict == "INFRASTRUCTURE":
                tell(f"interrupted; continue with --resume {outcome.folder}")
                judged.code = INTERRUPTED
            elif self.ledger is not None:
                api.record_verdict(outcome, self.ledger)
        return judged.code


@contextmanager
def group(title: str, *, wanted: bool) -> Generator[None]:
    """Fold what is said meanwhile on standard error, if that is wanted.

    Args:
        title: what is shown of it.
        wanted: whether GitHub's runner reads it.
    """
    if not wanted:
        yield
        return
    from nw_eval.reporting.github import END_GROUP, begin_group

    tell(begin_group(title))
    try:
        yield
    finally:
        tell(END_GROUP)
