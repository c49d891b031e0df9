"""Baselines: which exist, what they contain, and whether they still match this machine.

Listing, showing and comparing them imports no simulator.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.errors import IncomparableError, NwEvalError, PolicyError
from nw_eval.engine.how import How

if TYPE_CHECKING:
    from nw_eval.engine.plan import Plan
    from nw_gate.results.baseline import (
        BaselineChange,
        BaselineKey,
        BaselinePolicy,
        BaselineResults,
        FieldChange,
    )

_READERS = 4
"""Files that are read at a time: each by a process of its own, which mostly starts."""


@dataclass(frozen=True, kw_only=True)
class ListedBaseline:
    """A baseline, as far as it can be read."""

    file: Path
    suite: str
    """The folder that it lies in."""
    name: str
    baseline: BaselineResults | None = None
    mean: float | None = None
    """Mean success over scenes."""
    problem: str | None = None
    """Why it cannot be read."""


@dataclass(frozen=True, kw_only=True)
class ShownBaseline:
    """One baseline, and where it lies."""

    file: Path
    baseline: BaselineResults


def list_baselines() -> tuple[ListedBaseline, ...]:
    """Return the project's baselines, those of `reports/baselines`, and then the shipped ones."""
    from nw_gate.results.baseline_file import baseline_files

    with ThreadPoolExecutor(_READERS) as readers:
        return tuple(readers.map(_listed, baseline_files()))


def show_baseline(baseline: str | Path, *, suite: str | None = None) -> ShownBaseline:
    """Read one baseline.

    Args:
        baseline: a name, `<suite>/<name>`, or a path.
        suite: the suite's name, if several suites have a baseline of that name.

    Raises:
        UsageError: there is none, or it is not clear which.
        StoreError: it is damaged.
        IncomparableError: it is no baseline that anything can be compared with.
    """
    from nw_gate.results.baseline_file import find_any, read_baseline

    file = find_any(baseline, suite=suite)
    return ShownBaseline(file=file, baseline=read_baseline(file))


def diff_baselines(
    then: str | Path, now: str | Path, *, suite: str | None = None
) -> BaselineChange:
    """Compare two baselines: what they hold for, and what happened from their starts, by scene.

    Args:
        then: the earlier baseline: a name, `<suite>/<name>`, or a path.
        now: the later baseline.
        suite: the suite's name, if several suites have a baseline of that name.

    Raises:
        UsageError, StoreError, IncomparableError: as `show_baseline`.
    """
    from nw_gate.results.baseline import baseline_change

    baselines = [show_baseline(each, suite=suite).baseline for each in (then, now)]
    return baseline_change(*baselines)


def _listed(file: Path) -> ListedBaseline:
    from nw_gate.results.baseline import baseline_mean
    from nw_gate.results.baseline_file import read_baseline

    suite, name = file.parent.name, file.stem
    try:
        baseline = read_baseline(file)
    except NwEvalError as error:
        return ListedBaseline(file=file, suite=suite, name=name, problem=str(error))
    return ListedBaseline(
        file=file, suite=suite, name=name, baseline=baseline, mean=baseline_mean(baseline)
    )


_REPORTS = Path("reports")


@dataclass(frozen=True, kw_only=True)
class BaselineTarget:
    """A suite and a policy on this machine, with this nw-eval."""

    plan: Plan
    key: BaselineKey
    policy: BaselinePolicy
    machine: dict[str, str]

    @property
    def work(self) -> Path:
        """Where its trials are kept: one folder for each key, policy and machine type."""
        from nw_base.digest import digest_of
        from nw_eval.engine.provenance import journal_header

        header = journal_header(self.plan)
        key = [header.suite_digest, header.policy_digest, self.policy.checkpoint_digest]
        digest = digest_of([key, dict(header.scene_digests), dict(header.engine)])
        return _REPORTS / f"baseline-{self.plan.suite.name}-{digest[:8]}"

    def is_in(self, baseline: BaselineResults, starts: int) -> bool:
        """Whether a baseline has all of it, so that nothing need be run."""
        from nw_gate.results.baseline import key_changes, policy_changes

        return (
            baseline.manifest.starts == starts
            and not key_changes(baseline.manifest.key, self.key)
            and not policy_changes(baseline.manifest.policy, self.policy)
            and baseline.panel_of(self.machine) is not None
        )

    def held_out(self) -> BaselineTarget:
        """Return the same with starts of a seed set of its own, by its policy and the suite."""
        from nw_eval.engine.identity import policy_info
        from nw_eval.engine.provenance import run_info
        from nw_eval.suite import expand, override
        from nw_gate.baseline.match import fresh_seed
        from nw_gate.results.baseline import key_of
        from nw_gate.results.request import Request
        from nw_gate.results.run_folder import RunFolder

        settings = self.plan.suite.model_dump(by_alias=True)
        seed = fresh_seed(policy_info(self.plan.bundle), settings, purpose="held-out")
        suite = override(self.plan.suite, Request(seed=seed))
        plan = replace(self.plan, suite=suite, trials=expand(suite, self.plan.scenes))
        run = run_info(plan, RunFolder(path=Path(suite.name)), How())
        return replace(self, plan=plan, key=key_of(run))

    def with_starts(self, starts: int) -> BaselineTarget:
        """Return the same with another number of starts.

        Raises:
            UsageError: it is none.
        """
        from nw_eval.suite import expand, override
        from nw_gate.results.request import Request

        suite = override(self.plan.suite, Request(trials=starts))
        trials = expand(suite, self.plan.scenes)
        return replace(self, plan=replace(self.plan, suite=suite, trials=trials))


def baseline_target(suite: str | Path, *, policy: str | None, **changes: Any) -> BaselineTarget:
    """Return what a baseline of a suite would be.

    Args:
        suite: a file, or the name of a shipped one.
        policy: as for `run` (default: the suite's policy).
        changes: other fields of `Request`.

    Raises:
        UsageError, SuiteError, PolicyError: as `plan`.
    """
    from nw_eval.api.plans import plan as plan_of
    from nw_eval.engine.provenance import run_info
    from nw_eval.suite import load_suite
    from nw_gate.results.baseline import BaselinePolicy, key_of, machine_of
    from nw_gate.results.run_folder import RunFolder

    read = load_suite(suite)
    # Without a baseline: a baseline is a run like any other, of all its starts.
    gate = read.gate.model_copy(update={"baseline": None, "max_drop": None})
    alone = read.model_copy(update={"gate": gate})
    plan = plan_of(alone, policy=policy, record="none", **changes)
    run = run_info(plan, RunFolder(path=Path(read.name)), How())
    return BaselineTarget(
        plan=plan,
        key=key_of(run),
        policy=BaselinePolicy(
            name=plan.bundle.name,
            card_digest=run.policy.card_digest,
            checkpoint_digest=run.policy.checkpoint_digest,
            card=card_reference(run.policy.card),
        ),
        machine=machine_of(run),
    )


def card_reference(card: str) -> str:
    """Return what finds a card on another machine: a shipped name, a path, a hub's revision.

    Args:
        card: its absolute path; empty for a policy without one.

    Returns:
        Empty for a card that lies elsewhere.
    """
    from nw_base.files.shipped import shipped
    from nw_scenes.hub.reference import origin_of

    folder = Path(card).parent
    fetched = origin_of(folder) if card else None
    if fetched is not None:
        return f"{fetched.reference}@{fetched.revision}"
    for root in (shipped("policies").resolve(), Path.cwd()):
        if card and folder.is_relative_to(root):
            relative = folder.relative_to(root).as_posix()
            return relative if root != Path.cwd() else f"./{relative}"
    return ""


@dataclass(frozen=True, kw_only=True)
class CheckedBaseline:
    """A baseline against what it would be here and now."""

    file: Path
    baseline: BaselineResults
    changes: tuple[FieldChange, ...]
    """What must match and does not; none of it, and the baseline holds."""
    has_panel: bool
    """Whether it has this machine type."""
    machine: tuple[FieldChange, ...]
    """In what this machine type differs from the baseline's first; empty if it has this one."""
    unchecked: str | None = None
    """Why its policy was not looked at, where it is not here."""
    suite: str
    """The suite as it was asked for, or by its name."""
    policy: str
    """The baseline's policy as it was asked for, or as the baseline knows where it lies."""

    @property
    def exit_code(self) -> int:
        """0 if the baseline holds, 5 if it does not."""
        return IncomparableError.exit_code if self.changes else 0


def check_baseline(
    baseline: str | Path,
    *,
    suite: str | Path | None = None,
    policy: str | None = None,
    **changes: Any,
) -> CheckedBaseline:
    """Compare what a baseline holds for with what is here: suite, scenes, simulator, policy.

    Args:
        baseline: a name, `<suite>/<name>`, or a path.
        suite: the suite's file, if its name is not enough.
        policy: where the baseline's policy is (default: the path in the baseline).
        changes: of `Request`: checkpoint, render, allow_code.

    Raises:
        UsageError: there is no such baseline or suite.
        SuiteError: the suite cannot be used.
        StoreError: the baseline is damaged.
        IncomparableError: it is no baseline that anything can be compared with.
    """
    from nw_eval.suite import load_suite
    from nw_gate.results.baseline import key_changes, machine_changes, policy_changes

    named = None if suite is None else load_suite(suite).name
    shown = show_baseline(baseline, suite=named)
    saved, wanted = shown.baseline, str(suite or shown.baseline.manifest.suite)
    own, unchecked = saved.manifest.policy, None
    try:
        target: BaselineTarget = baseline_target(
            wanted, policy=policy or own.card or own.name, **changes
        )
        target = target.held_out() if saved.manifest.held_out else target
        moved = policy_changes(own, target.policy)
    except PolicyError as error:
        if policy is not None:
            raise
        target, moved, unchecked = (
            baseline_target(wanted, policy=None, **changes),
            (),
            error.message,
        )
    has_panel = saved.panel_of(target.machine) is not None
    return CheckedBaseline(
        file=shown.file,
        baseline=saved,
        changes=(*key_changes(saved.manifest.key, target.key), *moved),
        has_panel=has_panel,
        machine=() if has_panel else machine_changes(saved.panels[0].machine, target.machine),
        unchecked=unchecked,
        suite=wanted,
        policy=policy or own.typed,
    )
