"""The baseline's own trials on a class of machine that its bank has not seen.

They are a run of their own, `baseline/` in the folder of the candidate's: the bank's policy from
the starts that the candidate meets, in its order. The first of them show whether bits are the
bank's. If they are, nothing more of it runs. If not, the policy runs beside the candidate from
every start (a concurrent control), and the bank's numbers take no part in the comparison.

A part of a run looks at the first trials of the whole run, so that all parts find the same without
hearing of each other, and what the run would have found. Its control runs from its own starts.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

from nw_eval.errors import IncomparableError, PolicyError, TrialError
from nw_eval.files.inside import what_is
from nw_eval.gate.baseline.known import contradictions
from nw_eval.gate.baseline.match import renewing
from nw_eval.plural import plural
from nw_eval.protocol import PROTOCOLS
from nw_eval.results.bank import ControlArm, trajectory
from nw_eval.results.provenance import read_run_info

if TYPE_CHECKING:
    from nw_eval.engine.plan import Plan
    from nw_eval.engine.rounds import RunStanding
    from nw_eval.policies import Bundle
    from nw_eval.results.bank import Against
    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder

CHUNK = 16
"""Trials of the baseline that run at once: workers take some seconds to start."""


class Beside:
    """The bank's policy beside a candidate.

    Args:
        plan: the candidate's.
        against: the bank.
        folder: of the candidate's run.
        run: its run.json.
        workers: processes; one for each core if None.
        cluster: the address of the Ray cluster that trials run on; None = this machine.
        command: what was typed.
        cache: whether results of earlier runs are taken over.

    Raises:
        IncomparableError: the bank's policy is not here.
    """

    def __init__(
        self,
        plan: Plan,
        against: Against,
        folder: RunFolder,
        run: RunInfo,
        *,
        workers: int | None,
        cluster: str | None,
        command: tuple[str, ...],
        cache: bool,
    ) -> None:
        from nw_eval.api.running.plans import baseline_plan

        self.is_interrupted = False
        self._folder, self._nested = folder, folder.baseline
        self._against = against
        self._workers, self._cluster = workers, cluster
        self._command, self._cache = command, cache
        self._plan = baseline_plan(plan, _bundle(plan, against, run))
        self.places = set[int]()
        """Of what has run."""
        self._control: ControlArm | None = None

    @property
    def order(self) -> list[int]:
        """Places of all trials that there are to run, in order; of a part, those of its run."""
        return sorted(trial.place for trial in self._plan.trials if trial.place is not None)

    @property
    def control(self) -> ControlArm | None:
        """What has run so far; None if nothing has."""
        return self._control

    def run(self, places: Collection[int], *, exactly: bool = False) -> None:
        """Run the trials at some places of the candidate's order, those that have not run yet.

        Args:
            places: in the order.
            exactly: whether only these are to be kept of all that have run.

        Raises:
            TrialError: a trial of the bank's policy came to no result, or not to what the cache
                says.
        """
        from nw_eval.engine import session

        self.places = set(places) if exactly else self.places | set(places)
        is_begun = what_is(self._nested.run_json) == "file"
        session.carry_out(
            self._plan,
            workers=self._workers,
            cluster=self._cluster,
            out=None if is_begun else self._nested.path,
            resume=self._nested.path if is_begun else None,
            command=self._command,
            listener=None,
            enough=self._next,
            cache=self._cache,
        )
        own = read_run_info(self._nested.run_json)
        if own.cache is not None and own.cache.differing:
            raise TrialError(
                f"the baseline's policy {own.policy.name}: {own.cache.differing[0]}",
                fix="start a new run",
            )
        if own.interrupted:
            self.is_interrupted = True
            return
        self._control = ControlArm(run=own, rows=control_rows(self._nested, own, self._folder))

    def looks_like_the_bank(self) -> bool | tuple[str, ...]:
        """Return whether what has run has the bits of the bank; sentences where it contradicts it.

        Only a candidate on the bank's own starts can be asked.
        """
        assert self._control is not None, "something has run"
        bank, rows = self._against.bank, self._control.rows
        panel = bank.panels[0]
        if wrong := contradictions(rows, bank, panel):
            return wrong
        return all(
            trajectory(row)
            == panel.by_stratum[row.scene, row.perturbation][row.seed_index].trajectory
            for row in rows
        )

    def _next(self, ended: Mapping[int, Row]) -> RunStanding:
        from nw_eval.engine.rounds import RunStanding

        places = tuple(sorted(self.places))
        return RunStanding(
            first=0, followed=places, ahead=tuple(place for place in places if place not in ended)
        )


def control_rows(nested: RunFolder, own: RunInfo, folder: RunFolder) -> tuple[Row, ...]:
    """Return the rows of the baseline's run beside a candidate.

    Args:
        nested: its folder.
        own: its run.json.
        folder: of the candidate's run.

    Raises:
        TrialError: one is an error.
        StoreError: it is damaged.
    """
    from nw_eval.api.running.saved_run import saved_suite, saved_trials
    from nw_eval.results.ended import read_trials

    rows = read_trials(nested, own, saved_trials(own, saved_suite(own))).rows
    if errors := [row for row in rows if row.status == "error"]:
        raise TrialError(
            f"{plural(len(errors), 'trial')} of the baseline's policy {own.policy.name} ended in "
            f"errors, first {errors[0].trial_id}: {errors[0].error_text or errors[0].error_type}",
            fix=f"--resume {folder.path} tries them again",
        )
    return rows


def _bundle(plan: Plan, against: Against, run: RunInfo) -> Bundle:
    """Return the baseline's policy: where the request says, or the bank.

    Raises:
        IncomparableError: it is not there, cannot be used, or is another one.
    """
    from nw_eval.policies import find_card, load_bundle
    from nw_eval.rollout.confined.vetting import vet_bundle

    own = against.bank.manifest.policy
    reference = plan.request.baseline_policy or own.card or own.name
    try:
        bundle = vet_bundle(
            load_bundle(find_card(reference)),
            plan.suite.robot,
            protocol=PROTOCOLS[plan.suite.protocol],
            allow_code=plan.request.allow_code,
        )
    except PolicyError as error:
        fault = error.message
    else:
        ours, theirs = (
            (bundle.checkpoint_digest, bundle.digest),
            (own.checkpoint_digest, own.card_digest),
        )
        if ours == theirs:
            return bundle
        fault = (
            f"{reference} is another one: checkpoint {ours[0][:8]} and card {ours[1][:8]}, the "
            f"baseline's {theirs[0][:8]} and {theirs[1][:8]}"
        )
    raise IncomparableError(
        f"baseline {against.info.name} has not seen this class of machine, and its policy "
        f"{own.name} cannot be run on it: {fault}",
        fix="say where it lies with --baseline-policy PATH, or save a panel here: "
        f"`{renewing(run, against.bank)}`",
    )
