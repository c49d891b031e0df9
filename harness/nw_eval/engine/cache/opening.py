"""Whether a run uses the cache of trials, and the cache for one that does."""

from __future__ import annotations

from contextlib import contextmanager
from hashlib import sha256
from typing import TYPE_CHECKING

from nw_eval.engine.cache.key import Conditions, system
from nw_eval.engine.cache.known import KnownTrials
from nw_eval.engine.cache.nothing import NothingKnown
from nw_eval.engine.cache.store import TrialStore, limit_bytes
from nw_eval.engine.provenance import journal_header
from nw_eval.errors import StoreError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_eval.policies import Bundle
    from nw_eval.results.run_folder import RunFolder


@contextmanager
def known_trials(
    plan: Plan,
    folder: RunFolder,
    *,
    off: str,
    listener: Listener,
    doubted: Callable[[], None],
) -> Generator[KnownTrials | NothingKnown]:
    """Open the cache for a run, and keep it within its size afterwards.

    A cache that cannot be used is told, and never fails a run.

    Args:
        plan: what is to be run.
        folder: of the run, absolute.
        off: why the cache is not to be used; empty if it is.
        listener: told of what cannot be done.
        doubted: called when a result of the cache turns out to be wrong.

    Raises:
        UsageError: `NW_EVAL_CACHE_GB` is no size.
    """
    limit = limit_bytes()
    off = off or _unfit(plan) or ("NW_EVAL_CACHE_GB=0" if limit == 0 else "")
    if off:
        yield NothingKnown(off)
        return
    try:
        store = TrialStore.of_user()
    except StoreError as error:
        listener.message(f"no result is taken over from earlier runs, or kept for later: {error}")
        yield NothingKnown(error.message)
        return
    known = KnownTrials(
        store,
        Conditions(policy=plan.bundle.digest, engine=journal_header(plan).engine, system=system()),
        still_hold=_unchanged(plan.bundle),
        folder=folder,
        policy=plan.bundle.name,
        arm=plan.arm,
        say=listener.message,
        doubted=doubted,
        again=plan.again,
    )
    yield known
    if known.has_added:
        store.prune(limit)


def _unfit(plan: Plan) -> str:
    """Return why a plan's results may depend on more than is known of it; empty if they do not."""
    if plan.bundle.instance is not None:
        return "the policy is an object"
    if plan.bundle.card.adapter == "remote":
        return "the policy is on a server"
    if plan.bundle.code_sha256:
        return "the policy imports code"  # It may read other files, and import from other folders.
    if plan.render != "cpu":
        return f"--render {plan.render}"  # Pictures depend on the device and on its driver.
    return ""


def _unchanged(bundle: Bundle) -> Callable[[], bool]:
    """Return what says whether a policy's card is as it was: workers read it for themselves.

    That weights and scenes are, each trial looks for itself.
    """

    def digest() -> str:
        try:
            return sha256(bundle.card_text.encode()).hexdigest()
        except OSError:
            return ""

    before = digest()
    return lambda: digest() == before
