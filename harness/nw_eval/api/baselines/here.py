"""What a bank would be here and now: the plan that fills it, and what it would hold for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nw_eval.engine.plan import Plan
    from nw_eval.results.bank import BankKey, BankPolicy, SavedBank

_REPORTS = Path("reports")


@dataclass(frozen=True, kw_only=True)
class Here:
    """A suite and a policy on this machine, with this nw-eval."""

    plan: Plan
    key: BankKey
    policy: BankPolicy
    machine: dict[str, str]

    @property
    def work(self) -> Path:
        """Where its trials are kept: one folder for each key, policy and class of machine."""
        from nw_eval.engine.provenance import journal_header
        from nw_eval.suite.digest import digest_of

        header = journal_header(self.plan)
        key = [header.suite_digest, header.policy_digest, self.policy.checkpoint_digest]
        digest = digest_of([key, dict(header.scene_digests), dict(header.engine)])
        return _REPORTS / f"bank-{self.plan.suite.name}-{digest[:8]}"

    def is_in(self, bank: SavedBank, starts: int) -> bool:
        """Whether a bank has all of it, so that nothing need be run."""
        from nw_eval.results.bank_changes import key_changes, policy_changes

        return (
            bank.manifest.starts == starts
            and not key_changes(bank.manifest.key, self.key)
            and not policy_changes(bank.manifest.policy, self.policy)
            and bank.panel_of(self.machine) is not None
        )

    def with_starts(self, starts: int) -> Here:
        """Return the same with another number of starts.

        Raises:
            UsageError: it is none.
        """
        from nw_eval.request import Request
        from nw_eval.suite import expand, override

        suite = override(self.plan.suite, Request(trials=starts))
        trials = expand(suite, self.plan.scenes)
        return replace(self, plan=replace(self.plan, suite=suite, trials=trials))


def here(suite: str | Path, *, policy: str | None, **changes: Any) -> Here:
    """Return what a bank of a suite would be.

    Args:
        suite: a file, or the name of a shipped one.
        policy: as for `run`; the suite's own if None.
        changes: other fields of `Request`.

    Raises:
        UsageError, SuiteError, PolicyError: as `plan`.
    """
    from nw_eval.api.running.plans import plan as plan_of
    from nw_eval.engine.provenance import run_info
    from nw_eval.results.bank import BankPolicy, key_of, machine_of
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.suite import load_suite

    read = load_suite(suite)
    # Without a baseline: a bank is a run like any other, of all its starts.
    gate = read.gate.model_copy(update={"baseline": None, "max_drop": None})
    alone = read.model_copy(update={"gate": gate})
    plan = plan_of(alone, policy=policy, record="none", **changes)
    run = run_info(
        plan, RunFolder(path=Path(read.name)), workers=None, in_process=False, command=()
    )
    return Here(
        plan=plan,
        key=key_of(run),
        policy=BankPolicy(
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
    from nw_eval.files.shipped import shipped
    from nw_eval.hub.fetched import origin_of

    folder = Path(card).parent
    fetched = origin_of(folder) if card else None
    if fetched is not None:
        return f"{fetched.reference}@{fetched.revision}"
    for root in (shipped("policies").resolve(), Path.cwd()):
        if card and folder.is_relative_to(root):
            relative = folder.relative_to(root).as_posix()
            return relative if root != Path.cwd() else f"./{relative}"
    return ""
