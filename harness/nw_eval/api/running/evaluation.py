"""Evaluating what a training loop has at hand: a checkpoint, or the policy itself as an object."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from nw_eval.api.running.reports import RunReport
    from nw_eval.cards import Card
    from nw_eval.engine.listener import Listener
    from nw_eval.policies import Bundle
    from nw_eval.policies.policy import Observation

UNNAMED = "unnamed"
"""What rows have in place of a digest where nobody says which policy it was."""


class ActingPolicy(Protocol):
    """An object that acts. `reset(seed)`, and `state()` with `restore(state)`, are used if there.

    All trials have the same object: without `reset` it must have nothing to forget.
    """

    def act(self, observation: Observation, /) -> Any:
        """Return the action: twelve numbers, for the observations of the card by name."""
        ...


def evaluate(
    policy: str | Path | ActingPolicy | Callable[[Observation], Any],
    *,
    suite: str | Path,
    card: Card | Mapping[str, Any] | None = None,
    version: str = UNNAMED,
    out: str | Path | None = None,
    listener: Listener | None = None,
    **changes: Any,
) -> RunReport:
    """Roll a policy out through a suite, write the evidence, and judge it.

    A policy by name runs as `run` does it. An object runs in this process, one trial after another,
    each begun with `reset(seed)`; nothing confines it, and nothing ends it if it hangs. Its digest
    is what `version` says, which nobody can verify, and its logs cannot be replayed.

    Args:
        policy: a bundle's name, folder or card; or an object with `act(observation)`, or a function
            in place of that.
        suite: a suite file or the name of a shipped one.
        card: what an object sees and what its actions mean: at least `control`, and `observations`
            for one that looks. A mapping gets robot and name from the suite and the object.
        version: which policy an object is, such as its step or the hash of its weights.
        out: the run's folder; a new one in `reports/` if None.
        listener: hears of progress.
        changes: fields of `Request` by name, such as trials, scenes, record and seed; for a policy
            by name whatever `run` takes. The suite's own baseline counts for the suite's own policy
            by name; `baseline` names one for any other.

    Raises:
        UsageError: an object has no card, or a policy by name has one; no such suite.
        SuiteError: what is wrong with the suite and its scenes.
        PolicyError: the card or the checkpoint cannot be used.
        StoreError: results cannot be written; those that were written stay.
    """
    from nw_eval.api.running.plans import plan_of
    from nw_eval.api.running.runs import check_limits, judged, roll_out, run
    from nw_eval.errors import UsageError
    from nw_eval.request import Request
    from nw_eval.suite import draft_suite

    out = None if out is None else Path(out)
    if isinstance(policy, str | Path):
        if card is not None or version != UNNAMED:
            raise UsageError(
                f"policy {str(policy)!r} has a card and a digest of its own",
                fix="leave `card` and `version` out, or pass the policy as an object",
            )
        return run(suite, policy=str(policy), out=out, listener=listener, **changes)
    if card is None:
        raise UsageError(
            f"a policy that is an object ({type(policy).__name__}) needs a card",
            fix="pass `card={'control': ..., 'observations': ...}`",
        )
    bundle = _bundle(policy, suite, card, version)
    request = Request.of(suite, policy=bundle.name, **changes)
    check_limits(request, "a policy that is an object")
    folder = roll_out(
        plan_of(request, draft_suite(suite), bundle=bundle),
        workers=1,
        out=out,
        resume=None,
        listener=listener,
        in_process=True,
    )
    return judged(folder)


def _bundle(
    policy: object, suite: str | Path, card: Card | Mapping[str, Any], version: str
) -> Bundle:
    """Return an object with its card, completed from the suite and the object."""
    from nw_eval.cards.load import card_of
    from nw_eval.policies import instance_bundle
    from nw_eval.suite import load_suite

    if isinstance(card, Mapping):
        origin: Any = policy if hasattr(policy, "__name__") else type(policy)
        module, name = (
            re.sub(r"[^\w.]", "_", origin.__module__),
            re.sub(r"\W", "_", origin.__name__),
        )
        card = card_of(
            {
                "nw-policy": 1,
                "name": re.sub(r"[^a-z0-9.]+", "-", name.lower()).strip("-.")[:64] or "policy",
                "robot": card.get("robot") or load_suite(suite).robot,
                "adapter": f"python:{module}:{name}",
                **card,
            }
        )
    return instance_bundle(policy, card, digest=version)
