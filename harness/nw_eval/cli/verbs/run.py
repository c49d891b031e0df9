"""`nw-eval run`: roll a checkpoint out through a suite, and judge it."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from nw_base.words import Engine
from nw_eval.cli.terminal.last_words import tell
from nw_eval.cli.verbs.options import Options, Publishing


@dataclass(frozen=True, kw_only=True)
class Run(Publishing, Options):
    """Roll a checkpoint out through a suite, write the evidence, and give a verdict.

    A suite without a bar (`gate.success_rate`) is only run: its verdict is RAN, exit code 0.
    """

    leaves_verdict: ClassVar = True  # In a file, whatever becomes of the print.

    out: Path | None = None
    """The run's folder; `reports/<suite>-<policy>-<time>-<digest>` when absent."""
    resume: Path | None = None
    """The folder of an interrupted run to finish: what is not given is as the run was begun.
    Other trials, scenes, record, time or memory limit may be given with it.
    A robot, policy, checkpoint, seed, renderer or collision that makes other trials is refused."""

    label: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="KEY=VALUE")
    ] = ()
    """What you call the run, such as training_run=may-3, in its pages and in an index of runs;
    beside what CI's variables say of repository, commit, branch, pull_request, job and job_url.
    May be given again."""
    ledger: Path | None = None
    """Add the verdict to this ledger of verdicts (`nw-eval ledger` sums it up)."""
    in_process: bool = False
    """Run trials in this very process, one after another, so that `breakpoint()` works.
    For a policy that you trust: nothing confines it, and nothing ends it if it hangs."""
    no_cache: bool = False
    """Run every trial. Results of earlier runs of the very same trials are taken over otherwise,
    but for 2 % of them, which run again and are compared (`nw-eval cache`)."""

    all_rounds: bool = False
    """Run all trials. Against a baseline a run ends otherwise once the verdict is settled, and
    where the policy is the baseline itself its results are taken over but for --recheck."""
    engine: Engine = "local"
    """Where trials run: in processes of this machine, or on the nodes of a Ray cluster.
    Rows are the same; --resume may use another engine than the run began with."""
    address: str | None = None
    """With --engine ray: auto, host:port of the cluster's head, or ray://host:port.
    A cluster of this machine is started for the run when absent."""

    def __call__(self) -> int:
        from nw_base.errors import UsageError
        from nw_eval import api
        from nw_eval.api.ledgers import check_ledger
        from nw_eval.cli.terminal.interruption import INTERRUPTED
        from nw_eval.cli.terminal.progress import RunProgress
        from nw_eval.cli.verbs.options import summary
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
            print(summary(outcome, folded=self.on_github))
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
