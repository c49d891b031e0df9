"""Which results one run takes from the cache of trials, which run again, and which it adds.

A key may lack something that changes results, a file may have been tampered with, a machine may be
faulty. So some results that the cache has are computed again, drawn at random in a way that cannot
be predicted, and compared. Until those agree no cached result is used. If one differs, all entries
of the same conditions are void, the run makes no further use of the cache, and says so for good.

`known_trials` says whether a run uses the cache at all.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import KW_ONLY, dataclass, field
from hashlib import sha256
from math import floor
from random import Random, SystemRandom
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.errors import StoreError
from nw_base.plugins import code_named
from nw_base.plural import plural
from nw_eval.engine.cache import NO_ENTRY, CacheEntry, Conditions, TrialStore, limit_bytes, system
from nw_eval.engine.provenance import journal_header
from nw_eval.engine.rows import taken_over
from nw_gate.results.ended import of_plan
from nw_gate.results.provenance import CacheInfo

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Sequence
    from pathlib import Path

    from nw_base.words import Arm
    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_gate.results.row import Row
    from nw_gate.results.run_folder import RunFolder
    from nw_policies import Bundle
    from nw_sim.rollout.job import TrialJob

SHARE = 0.02
"""Of the results that could be reused, how many run all the same; at least one does."""


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
        listener.message(
            f"results of earlier runs are not used, and none is kept for later: {error}"
        )
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
    for key in plan.suite.plugins:
        if not code_named(key):  # It may be edited, and keep its version.
            return f"the code of {key} is not found"
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


@dataclass(eq=False)
class KnownTrials:
    """The cache as one run uses it."""

    store: TrialStore
    conditions: Conditions
    """Of the run."""
    _: KW_ONLY
    still_hold: Callable[[], bool]
    """Says whether the policy's card is the one whose digest the conditions have."""
    folder: RunFolder
    policy: str
    """The policy's name, for rows."""
    arm: Arm
    """Whether it is the one that is judged, for rows."""
    say: Callable[[str], None]
    """Hears one line for people."""
    doubted: Callable[[], None]
    """Called whenever a result differs, so that it is written down at once."""
    again: Collection[str] = ()
    """Trials that run in any case."""
    chance: Random = field(default_factory=SystemRandom)
    """Draws the trials to re-run."""

    def __post_init__(self) -> None:
        self.has_added = False
        self._compared = 0
        self._differing: list[str] = []
        self._expected: dict[str, Row] = {}  # By trial: what the cache says of those that run.
        self._waiting: dict[str, tuple[TrialJob, Row]] = {}
        self._broken: set[str] = set()  # Trials whose entry has lost its log.
        self._is_full = False

    @property
    def info(self) -> CacheInfo:
        """What run.json is to say."""
        return CacheInfo(reexecuted=self._compared, differing=tuple(self._differing))

    def to_run(self, jobs: Sequence[TrialJob]) -> list[TrialJob]:
        """Return those of some jobs that are to run; the results of the others wait.

        Those that the cache knows all the same come first, the longest of them before the others:
        all that waits is waiting for the last of them. Once one has come out otherwise, all run,
        and what has waited for it comes first.
        """
        if self._differing:
            return [*self._in_vain(), *jobs]
        found = {job.trial.id: known for job in jobs if (known := self._find(job)) is not None}
        wanted = {name for name in found if name in self.again}
        again = wanted | self._drawn(sorted(set(found) - wanted), is_enough=bool(wanted))
        self._expected |= {name: found[name][1] for name in again}
        others = [job for job in jobs if job.trial.id in found and job.trial.id not in again]
        logs = [(found[job.trial.id][0], self._log_of(job)) for job in others]
        with ThreadPoolExecutor() as pool:  # Hashing holds no lock.
            linked = list(pool.map(_is_linked, *zip(*logs, strict=True))) if logs else []
        for job, is_linked in zip(others, linked, strict=True):
            name = job.trial.id
            if is_linked:
                self._waiting[name] = job, found[name][1]
            else:
                self._broken.add(name)
        run = [job for job in jobs if job.trial.id not in self._waiting]
        steps = {name: row.steps for name, row in self._expected.items()}
        return sorted(run, key=lambda job: -steps.get(job.trial.id, -1))

    def ended(self, job: TrialJob, row: Row) -> None:
        """Compare a trial that has run with what the cache says of it, and keep it."""
        if row.status != "ok":
            return
        expected = self._expected.pop(job.trial.id, None) or self._row_of(job)
        if expected is not None:
            self._compared += 1
            if expected.digest != row.digest:
                self._doubt(expected, row)
            elif job.trial.id not in self._broken:
                return
        self._keep(job, row)

    def agreed(self, *, at_last: bool = False) -> list[Row]:
        """Return the rows that wait, once what ran of the cache's has come out as it says.

        Args:
            at_last: whether nothing that is to be compared will run any more: what ended in an
                error cannot be.
        """
        if self._differing or not self._compared or (self._expected and not at_last):
            return []
        rows = [row for _, row in self._waiting.values()]
        self._waiting.clear()
        return rows

    def unconfirmed(self) -> list[TrialJob]:
        """Return the jobs that have waited in vain."""
        self._expected.clear()
        return self._in_vain()

    def _in_vain(self) -> list[TrialJob]:
        jobs = [job for job, _ in self._waiting.values()]
        for job in jobs:
            with suppress(OSError):
                self._log_of(job).unlink()
        self._waiting.clear()
        return jobs

    def _find(self, job: TrialJob) -> tuple[CacheEntry, Row] | None:
        """Return the entry of a job, and the row that its trial would have in this run."""
        entry = self.store.find(self.conditions, self.conditions.key(job))
        if entry is None:
            return None
        row = taken_over(entry.row, job, policy=self.policy, arm=self.arm, folder=self.folder)
        try:
            of_plan([row], [job.trial], checkpoint=job.checkpoint_digest)
        except StoreError:
            return None
        if not _is_worth_keeping(row):
            return None
        entry.touch()
        return entry, row

    def _log_of(self, job: TrialJob) -> Path:
        return self.folder.cached_mcap(job.trial.scene, job.trial.id)

    def _row_of(self, job: TrialJob) -> Row | None:
        known = self._find(job)
        return None if known is None else known[1]

    def _drawn(self, names: Sequence[str], *, is_enough: bool) -> set[str]:
        """Return which of the known trials run all the same; of none, if others do, maybe none."""
        if not names:
            return set()
        mean = SHARE * len(names)
        count = floor(mean) + (self.chance.random() < mean - floor(mean))
        if not (is_enough or self._compared or self._expected):
            count = max(count, 1)
        return set(self.chance.sample(names, count))

    def _doubt(self, expected: Row, row: Row) -> None:
        count = self.store.void(self.conditions)
        self._differing.append(
            f"trial {row.trial_id} has another result than in the cache of trials "
            f"({row.outcome} after {row.steps} steps, {row.digest[:8]}; in the cache "
            f"{expected.outcome} after {expected.steps}, {expected.digest[:8]}): results that were "
            "used from the cache may be wrong; start a new run, which does not use them"
        )
        self.say(f"{self._differing[-1]}; {plural(count, 'entry', 'entries')} of the cache voided")
        self.doubted()

    def _keep(self, job: TrialJob, row: Row) -> None:
        if job.mcap is None or not _is_worth_keeping(row) or self._is_full:
            return
        if not self.still_hold():
            return
        try:
            self.store.put(self.conditions, self.conditions.key(job), row, job.mcap)
        except FileNotFoundError:
            pass  # Another process has just removed what it would have been put into.
        except (OSError, ValueError) as error:
            self._is_full = True
            why = (isinstance(error, OSError) and error.strerror) or error
            self.say(
                f"results are not kept for later runs: {self.store.folder} cannot be written: "
                f"{clean(why, at_most=200)}"
            )
        else:
            self.has_added = True


def _is_linked(entry: CacheEntry, log: Path) -> bool:
    """Put an entry's log in a run's place; return whether it was what was kept."""
    try:
        entry.link_log(log)
    except NO_ENTRY:
        return False
    return True


def _is_worth_keeping(row: Row) -> bool:
    """Whether a later run may take a row over.

    An error is none of the policy's; one that repeated, and so became a result, or a trial that
    needed a second attempt, deserves to be seen again. And every result has its log.
    """
    is_plain = row.status == "ok" and row.outcome != "policy_failed" and row.attempt == 1
    return is_plain and row.mcap_bytes > 0


class NothingKnown:
    """Knows no trial and keeps none: every job runs. In place of a `KnownTrials`.

    Args:
        why: the cache is not used.
    """

    def __init__(self, why: str = "") -> None:
        self.info = CacheInfo(off=why)

    def to_run(self, jobs: Sequence[TrialJob]) -> list[TrialJob]:
        """Return all jobs."""
        return list(jobs)

    def ended(self, job: TrialJob, row: Row) -> None:
        """Forget it."""

    def agreed(self, *, at_last: bool = False) -> list[Row]:  # noqa: ARG002 - nothing waits.
        """Return nothing."""
        return []

    def unconfirmed(self) -> list[TrialJob]:
        """Return nothing."""
        return []
