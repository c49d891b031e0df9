"""A run against a bank: what comes before its first trial, and after which round it may end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from nw_eval.api.running.plans import rechecks
from nw_eval.gate.absolute import judge
from nw_eval.gate.baseline.combine import settled
from nw_eval.gate.baseline.judge import compare
from nw_eval.plural import plural
from nw_eval.results.bank.manifest import machine_of

if TYPE_CHECKING:
    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_eval.gate.baseline.comparison import Checked, Comparison
    from nw_eval.results.bank.against import Against
    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder


class Contest:
    """A candidate's run against a bank, as `engine.session` asks about it.

    Args:
        plan: the candidate's.
        against: the bank.
        workers: processes; one for each core if None.
        cluster: the address of the Ray cluster that trials run on; None = this machine.
        command: what was typed.
        listener: hears of progress.
        cache: whether results of earlier runs are taken over.
    """

    def __init__(
        self,
        plan: Plan,
        against: Against,
        *,
        workers: int | None,
        cluster: str | None,
        command: tuple[str, ...],
        listener: Listener,
        cache: bool,
    ) -> None:
        self._plan = plan
        self._against = against
        self._workers = workers
        self._cluster = cluster
        self._command = command
        self._listener = listener
        self._cache = cache
        self._run: RunInfo | None = None

    def begin(self, folder: RunFolder, run: RunInfo) -> RunInfo:
        """Return what run.json is to say once it is known what the bank is to this machine.

        On a class of machine that the bank has no panel of, its own policy is run first.

        Args:
            folder: of the run.
            run: its run.json.

        Raises:
            IncomparableError: the bank's policy is not here, or the bank has too few starts for a
                class of machine on which bits are others.
            TrialError: a trial of the bank's policy came to no result.
        """
        from nw_eval.api.running.against.baseline_run import run_baseline

        name, own = self._against.info.name, self._plan.bundle.name
        if self._plan.is_baseline:
            count = plural(rechecks(self._plan.request), "start")
            self._listener.message(
                f"{own} is the policy of baseline {name}: {count} of each scene run again, and if "
                "they are as it says the rest is taken over"
            )
        elif self._is_seen(run):
            pass
        else:
            self._listener.message(
                f"baseline {name} has not seen this class of machine: its own policy runs first"
            )
            run = run_baseline(
                self._plan,
                self._against,
                folder,
                run,
                workers=self._workers,
                cluster=self._cluster,
                command=self._command,
                listener=self._listener,
                cache=self._cache,
            )
        self._run = run
        return run

    def enough(self, rows: Sequence[Row]) -> bool:
        """Whether bar and baseline are settled by the rows of the rounds so far."""
        run = self._run
        assert run is not None, "a run begins before its first round ends"
        assert run.baseline is not None, "a run against a bank says so"
        found = self._compare(rows, run, run.baseline.checked)
        if self._plan.is_baseline and found.again is not None:
            if found.rounds < rechecks(self._plan.request):
                return False
            errors = any(row.status == "error" for row in rows)
            if errors or found.again.equal or found.again.differing:
                return True
            if not found.again.settled:  # Bits are others, and scores may be.
                return False
        planned = Counter(row.scene for row in rows)
        return settled(judge(rows, self._plan.suite.gate, planned, against=found), found)

    def _is_seen(self, run: RunInfo) -> bool:
        """Whether nothing of the baseline need be run on this machine."""
        if self._against.bank.panel_of(machine_of(run)) is not None:
            return True
        return self._compare((), run, "bits").basis == "same"

    def _compare(self, rows: Sequence[Row], run: RunInfo, checked: Checked | None) -> Comparison:
        gate = self._plan.suite.gate
        return compare(rows, run, self._against.bank, gate, checked=checked)
