"""`nw-eval baseline`: what a policy scores from every start, saved to be compared with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from nw_eval.words import Backend


@dataclass(frozen=True, kw_only=True)
class Save:
    """Run what is missing of a baseline, and save it as reports/baselines/<suite>/<name>.parquet.

    Says first about how long it takes. A save that Ctrl-C interrupted goes on when the same command
    is given again, and writes the same results. A baseline that is there gets this
    class of machine, too. One that holds for something else is replaced with --renew only, after
    what moved is shown (exit code 5 without it).
    """

    suite: tyro.conf.Positional[str]
    """A suite file, or the name of a shipped suite."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """A shipped bundle's name, a bundle's folder, or a card; the suite's own when absent."""
    checkpoint: Path | None = None
    """Weights to use in place of those that the card names."""
    starts: int | None = None
    """Starts in each scene; as many as the baseline has, and 60 for a new one, when absent."""
    name: str | None = None
    """The baseline's name; the policy's when absent."""
    note: str = ""
    """Why it is saved."""
    from_run: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    """The folder of a finished run to save as a baseline; nothing is run."""
    renew: bool = False
    """Replace the baseline that is there, with its panels of all classes of machine."""
    render: Backend | None = None
    """The splat renderer; cpu when absent."""
    time_limit: float | None = None
    """Seconds of wall time after which a trial counts as hung."""
    memory_limit: str | None = None
    """Memory that a worker may hold with the processes that it started, such as 2GB or 1.5GiB."""
    allow_code: bool = False
    """Let the policy's card import Python code."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes; the number of cores when absent."""
    no_cache: bool = False
    """Run every trial, and keep no result for later runs."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.progress import RunProgress
        from nw_eval.cli.text.judging.baseline_changes import saved_page
        from nw_eval.errors import IncomparableError

        with RunProgress() as progress:
            saved = api.save_baseline(
                self.suite,
                policy=self.policy,
                starts=self.starts,
                name=self.name,
                note=self.note,
                from_run=self.from_run,
                renew=self.renew,
                workers=self.workers,
                cache=not self.no_cache,
                listener=progress,
                checkpoint=self.checkpoint,
                render=self.render,
                time_limit=self.time_limit,
                memory_limit=self.memory_limit,
                allow_code=self.allow_code,
            )
        print(saved_page(saved))
        return IncomparableError.exit_code if saved.action == "kept" else 0


@dataclass(frozen=True, kw_only=True)
class List:
    """List the baselines of the project and those that are shipped."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.baselines import baseline_table

        print(baseline_table(api.list_baselines()))
        return 0


@dataclass(frozen=True, kw_only=True)
class Show:
    """Say what a baseline holds for, who saved it and why, and what it holds, scene by scene."""

    baseline: tyro.conf.Positional[str]
    """A name, suite/name, or a path."""
    suite: str | None = None
    """The suite's name, where several have a baseline of that name."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.baselines import baseline_page

        print(baseline_page(api.show_baseline(self.baseline, suite=self.suite)))
        return 0


@dataclass(frozen=True, kw_only=True)
class Check:
    """Say whether a baseline still holds here: suite, scenes, protocol, simulator, policy.

    Exit code 5 if it does not. Says, too, whether it has a panel of this class of machine.
    """

    baseline: tyro.conf.Positional[str]
    """A name, suite/name, or a path."""
    suite: str | None = None
    """The suite's file, where its name does not find it."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """Where the baseline's policy lies, if not where the baseline says."""
    checkpoint: Path | None = None
    """Weights to use in place of those that the card names."""
    render: Backend | None = None
    """The splat renderer; cpu when absent."""
    allow_code: bool = False
    """Let the policy's card import Python code."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.baseline_changes import checked_page

        checked = api.check_baseline(
            self.baseline,
            suite=self.suite,
            policy=self.policy,
            checkpoint=self.checkpoint,
            render=self.render,
            allow_code=self.allow_code,
        )
        print(checked_page(checked))
        return checked.exit_code


@dataclass(frozen=True, kw_only=True)
class Verify:
    """Run starts of a baseline again by its own policy, and name each row that differs.

    Which starts is drawn by a seed that nobody can foresee. Exit code 5 if a row differs, 4 if a
    trial comes to no result. Nothing is written into the project.
    """

    baseline: tyro.conf.Positional[str]
    """A name, suite/name, or a path."""
    share: Annotated[str | None, tyro.conf.arg(metavar="N%")] = None
    """Share of all its starts, at least one; 10% when absent."""
    trials: int | None = None
    """How many starts instead."""
    seed: int | None = None
    """Draw the starts of an earlier verification again, which printed this number."""
    suite: str | None = None
    """The suite's file, where its name does not find it."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """Where the baseline's policy lies, if not where the baseline says."""
    checkpoint: Path | None = None
    """Weights to use in place of those that the card names."""
    render: Backend | None = None
    """The splat renderer; cpu when absent."""
    allow_code: bool = False
    """Let the policy's card import Python code."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes; the number of cores when absent."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.interruption import INTERRUPTED
        from nw_eval.cli.terminal.last_words import tell
        from nw_eval.cli.terminal.progress import RunProgress
        from nw_eval.cli.text.judging.baseline_changes import verified_page

        with RunProgress() as progress:
            verified = api.verify_baseline(
                self.baseline,
                share=self.share,
                trials=self.trials,
                seed=self.seed,
                suite=self.suite,
                policy=self.policy,
                workers=self.workers,
                listener=progress,
                checkpoint=self.checkpoint,
                render=self.render,
                allow_code=self.allow_code,
            )
        print(verified_page(verified))
        if verified.interrupted:
            tell("interrupted; not all of the trials that were drawn have run")
            return INTERRUPTED
        return verified.exit_code


@dataclass(frozen=True, kw_only=True)
class Diff:
    """Compare two baselines: what they hold for, means by scene, starts that ended otherwise."""

    then: tyro.conf.Positional[str]
    """The earlier one: a name, suite/name, or a path."""
    now: tyro.conf.Positional[str]
    """The later one."""
    suite: str | None = None
    """The suite's name, where several have a baseline of such a name."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.baseline_changes import change_page

        print(change_page(api.diff_baselines(self.then, self.now, suite=self.suite)))
        return 0


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """Save what a policy scores from every start; list, show, check, verify, compare baselines."""

    action: (
        Annotated[Save, tyro.conf.subcommand("save")]
        | Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Show, tyro.conf.subcommand("show")]
        | Annotated[Check, tyro.conf.subcommand("check")]
        | Annotated[Verify, tyro.conf.subcommand("verify")]
        | Annotated[Diff, tyro.conf.subcommand("diff")]
    )

    def __call__(self) -> int:
        return self.action()
