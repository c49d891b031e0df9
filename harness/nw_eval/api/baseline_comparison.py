"""A run against a baseline: its checks before the first trial, and when it may end.

On a machine type that its baseline has not seen the baseline has trials of its own. They are a
run of their own, `baseline/` in the folder of the candidate's: the baseline's policy from the
starts that the candidate meets, in its order. The first of them show whether bits are the
baseline's. If they are, nothing more of it runs. If not, the policy runs beside the candidate from
every start (a concurrent control), and the baseline's numbers take no part in the comparison.

A part of a run looks at the first trials of the whole run, so that all parts reach the same
decisions as the whole run, with no exchange. Its control runs from its own initial states.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

from nw_base.errors import IncomparableError, PolicyError, TrialError
from nw_base.files.inside import what_is
from nw_base.plural import plural
from nw_base.protocol import PROTOCOLS
from nw_eval.api.loaded_baselines import control_rows
from nw_eval.api.plans import rechecks
from nw_eval.engine.machine import worker_count
from nw_eval.engine.rounds import RunStanding
from nw_eval.engine.session import Session, stop_of
from nw_gate.absolute import word_of_bar
from nw_gate.baseline.judge import setup_of
from nw_gate.baseline.match import contradictions, is_baseline, recheck, renewing
from nw_gate.results.baseline import ControlArm, machine_of, trajectory
from nw_gate.results.provenance import StopInfo

if TYPE_CHECKING:
    from nw_eval.engine.how import How
    from nw_eval.engine.machine import Interrupts
    from nw_eval.engine.plan import Plan
    from nw_gate.baseline.finding import Finding
    from nw_gate.baseline.judge import ComparisonSetup
    from nw_gate.results.baseline import LoadedBaseline, Stratum
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row
    from nw_gate.verdict import Word
    from nw_policies import Bundle


class BaselineComparison:
    """A candidate's run against a baseline, as `engine.session` asks about it.

    A context manager, which closes the control's run.

    Args:
        plan: the candidate's.
        against: the baseline.
        how: how both run.
    """

    def __init__(self, plan: Plan, against: LoadedBaseline, how: How) -> None:
        self._plan = plan
        self._against = against
        self._how = how
        self._cleanup = ExitStack()
        self._control: ConcurrentControl | None = None
        self._setup: ComparisonSetup | None = None
        self._bar: tuple[int, Word] | None = None
        self._looked = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:  # noqa: PYI036 - an exit stack wants their types.
        self._cleanup.__exit__(*error)

    def begin(self, own: Session, interrupts: Interrupts) -> RunInfo:
        """Return what run.json is to say once it is known what the baseline is to this machine.

        On a machine type that the baseline has no results of, some trials of its own policy run
        first: they show whether bits are the baseline's.

        Args:
            own: the candidate's run, of which no trial has run in this session.
            interrupts: receives signals while trials run.

        Raises:
            IncomparableError: the baseline's policy is not here.
            TrialError: a trial of the baseline's policy produced no result.
        """
        run, name, policy = own.info, self._against.info.name, self._plan.bundle.name
        if self._plan.is_baseline:
            count = plural(rechecks(self._plan.request), "initial state")
            self._how.told.message(
                f"{policy} is the policy of baseline {name}: {count} per scene re-run; if the "
                "results match, the others come from the baseline"
            )
        elif not self._has_results_here(run):
            run = self._check_machine(own, interrupts)
        if not run.interrupted and (run.stop is None or run.stop.trials):
            self._setup = setup_of(run, self._against, self._plan.suite.gate)
        return run

    def run_control(self, indexes: Sequence[int]) -> None:
        """Run more trials of the control, from starts that the candidate meets next.

        Args:
            indexes: in the drawn order.

        Raises:
            TrialError: one produced no result.
        """
        assert self._control is not None, "it has started"
        assert self._setup is not None, "it has started"
        self._control.run(indexes)
        if not self._control.is_interrupted:
            self._against = replace(self._against, control=self._control.arm)
            self._setup = replace(self._setup, against=self._against)

    def end(self, run: RunInfo) -> None:
        """Keep of a control the trials that are judged, and no more; of a part's, all.

        Args:
            run: its run.json, once its trials have ended.
        """
        control = self._control
        if control is None or control.is_interrupted or run.interrupted or run.shard is not None:
            return
        if run.baseline is not None and run.baseline.checked == "control":
            every = range(len(self._plan.trials))
            stop = run.stop
            control.run([x for x in every if stop is None or stop.wants(x)], exactly=True)

    def _check_machine(self, own: Session, interrupts: Interrupts) -> RunInfo:
        """Return run.json with what trials of the baseline show of this machine type."""
        name, run = self._against.info.name, own.info
        self._how.told.message(
            f"baseline {name} has no results for this machine type, which is normal: its own "
            "policy runs first as a check"
        )
        self._control = control = self._cleanup.enter_context(
            ConcurrentControl(self._plan, self._against, own, interrupts, self._how)
        )
        control.run(control.order[:CHUNK])
        if control.is_interrupted:
            return run.model_copy(update={"interrupted": True})
        self._against = replace(self._against, control=control.arm)
        alike = self._plan.panel == "pinned" and control.has_the_baselines_results()
        if isinstance(alike, tuple):
            known = self._against.info.model_copy(update={"moved": alike})
            return run.model_copy(update={"baseline": known, "stop": StopInfo(first=0)})
        if not alike:
            self._how.told.message(
                "this machine computes slightly different results from the one that saved baseline "
                f"{name}, which is normal between processors: {self._plan.bundle.name} is compared "
                "with the baseline's policy, which runs here from the same initial states"
            )
        if not alike and self._plan.shard is not None:
            # A part has all its trials, so that nothing is gained by waiting for the candidate's.
            control.run([trial.place for trial in self._plan.trials if trial.place is not None])
            if control.is_interrupted:
                return run.model_copy(update={"interrupted": True})
            self._against = replace(self._against, control=control.arm)
        checked = "bits" if alike else "control"
        known = self._against.info.model_copy(update={"checked": checked, "moved": ()})
        return run.model_copy(update={"baseline": known})

    def next(self, ended: Mapping[int, Row]) -> RunStanding:
        """Return how bar and baseline stand, and which trials come next.

        The bar and the mean rest on the first trials of the drawn order, all of them. The run ends
        at the first trial after which one of them flags or both pass. Then only scenes can be
        left that hold back a PASS of the baseline; their trials do not bear on bar or mean.

        Args:
            ended: rows of trials that have ended, by index in the order.
        """
        now, control = self._standing(ended), self._control
        if now.pending and control is not None and self._is_controlled:
            lacking = tuple(x for x in now.pending if x not in control.indexes)
            if lacking and lacking[0] in now.pending[: worker_count(self._how.workers, CHUNK)]:
                return replace(now, lacks=lacking[:CHUNK])
        return replace(now, pending=tuple(x for x in now.pending if x not in ended))

    @property
    def _is_controlled(self) -> bool:
        return self._setup is not None and self._setup.basis == "control"

    def _standing(self, ended: Mapping[int, Row]) -> RunStanding:
        setup = self._setup
        assert setup is not None, "a run begins before its first trial ends"
        every, count = range(len(self._plan.trials)), _first_missing(ended)
        if self._how.all_rounds:
            met = setup.met(list(ended.values()))
            is_met = met.ended(every)
            return RunStanding(first=len(every), pending=tuple(x for x in every if not is_met[x]))
        if (
            self._plan.is_baseline
            and (known := self._standing_of_recheck(ended, setup)) is not None
        ):
            return known
        setup = setup.on(list(ended.values()))
        finding = setup.find(setup.met(list(ended.values())))
        bar = self._bar_by(ended, count)
        first = _ends_at(finding, bar)
        if first is None:
            rest = {x for x in every if x not in ended} | set(finding.pending)
            return RunStanding(first=count, pending=tuple(sorted(rest)))
        missing = [x for x in range(first) if x not in ended]
        passes = finding.word != "REGRESSED" and (bar is None or bar[1] != "REGRESSED")
        has_followed = passes or (finding.followed and finding.followed[-1] >= first)
        return RunStanding(
            first=first,
            followed=tuple(x for x in finding.followed if x >= first) if has_followed else (),
            pending=tuple(sorted({*missing, *(finding.pending if passes else ())})),
            waits_for=_names(finding.waits_for) if passes else (),
        )

    def _standing_of_recheck(
        self, ended: Mapping[int, Row], setup: ComparisonSetup
    ) -> RunStanding | None:
        """Return what comes next of the baseline's own policy: some starts of each scene.

        None where the baseline has not seen the machine type, and bits are others: its trials
        are judged against the baseline, and by the bar, as any candidate's are.
        """
        every = range(len(self._plan.trials))
        first = min(rechecks(self._plan.request) * len(setup.strata), len(every))
        if missing := tuple(x for x in range(first) if x not in ended):
            return RunStanding(first=first, pending=missing)
        rows = [ended[x] for x in range(first)]
        again = recheck(rows, setup.run, setup.results)
        if any(row.status == "error" for row in rows) or again.equal or again.differing:
            return RunStanding(first=first)
        try:
            setup.on(rows)
        except IncomparableError:  # No further trial would help: the verdict says why.
            return RunStanding(first=first)
        return None

    def _bar_by(self, ended: Mapping[int, Row], count: int) -> tuple[int, Word] | None:
        """Return after how many of the first trials the bar is decided, and how; None if open."""
        if self._bar is None and self._plan.suite.gate.success_rate is None:
            self._bar = 0, "RAN"
        while self._bar is None and self._looked < count:
            self._looked += 1
            rows = [ended[index] for index in range(self._looked)]
            scenes = [scene.name for scene in self._plan.scenes]
            word = word_of_bar(rows, self._plan.suite.gate, scenes)
            if word in {"PASS", "REGRESSED"}:
                self._bar = self._looked, word
        return self._bar

    def _has_results_here(self, run: RunInfo) -> bool:
        """Whether nothing of the baseline need be run on this machine."""
        if self._against.results.panel_of(machine_of(run)) is not None:
            return True
        return is_baseline(run.policy, self._against.results)


def _names(strata: Iterable[Stratum]) -> tuple[str, ...]:
    """Return the scenes of strata, each once."""
    return tuple(dict.fromkeys(scene for scene, _ in strata))


def _first_missing(ended: Mapping[int, Row]) -> int:
    return next(index for index in range(len(ended) + 1) if index not in ended)


def _ends_at(finding: Finding, bar: tuple[int, Word] | None) -> int | None:
    """Return how many of the first trials of the order bear on bar and mean; None if not settled.

    Args:
        finding: of the baseline.
        bar: after how many trials it was decided, and how.
    """
    flags = [bar[0]] if bar is not None and bar[1] == "REGRESSED" else []
    by_scene = finding.word == "REGRESSED" and bool(finding.followed)
    if finding.word == "REGRESSED" and not by_scene:
        flags.append(finding.first)
    mean_passes = finding.word == "PASS" or by_scene or bool(finding.waits_for)
    passes = None
    if mean_passes and bar is not None and bar[1] != "REGRESSED":
        passes = max(finding.first, bar[0])
    if by_scene:
        flagged = finding.followed[-1] + 1
        if passes is not None and passes < flagged:
            return passes
        flags.append(flagged)
    return min(flags) if flags else passes


CHUNK = 16
"""Trials of the baseline that run at once: workers take some seconds to start."""


class ConcurrentControl:
    """The baseline's policy beside a candidate: a run of its own; a context manager.

    Args:
        plan: the candidate's.
        against: the baseline.
        own: the candidate's run.
        interrupts: receives signals while trials run.
        how: how the candidate runs.

    Raises:
        IncomparableError: the baseline's policy is not here.
    """

    def __init__(
        self, plan: Plan, against: LoadedBaseline, own: Session, interrupts: Interrupts, how: How
    ) -> None:
        from nw_eval.api.plans import baseline_plan

        self._folder, self._against, self._interrupts = own.folder, against, interrupts
        self._plan = baseline_plan(plan, baseline_bundle(plan, against, own.info))
        nested = own.folder.baseline
        is_begun = what_is(nested.run_json) == "file"
        self._session = Session(
            self._plan,
            # A policy by its card is behind the fence, also where the candidate is not.
            replace(how, listener=None, in_process=False, labels=None),
            interrupts,
            out=None if is_begun else nested.path,
            resume=nested.path if is_begun else None,
        )
        self.indexes = set[int]()
        """Indexes of the trials that have run."""
        self._arm: ControlArm | None = None

    def __enter__(self) -> Self:
        self._session.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:  # noqa: PYI036 - an exit stack wants their types.
        self._session.__exit__(*error)

    @property
    def is_interrupted(self) -> bool:
        """Whether a signal came."""
        return self._interrupts.requested is not None

    @property
    def order(self) -> list[int]:
        """Indexes of all trials that there are to run, in order; of a part, those of its run."""
        return sorted(trial.place for trial in self._plan.trials if trial.place is not None)

    @property
    def arm(self) -> ControlArm | None:
        """What has run so far; None if nothing has."""
        return self._arm

    def run(self, indexes: Collection[int], *, exactly: bool = False) -> None:
        """Run the trials at some positions of the candidate's order, those that have not run yet.

        Args:
            indexes: in the order.
            exactly: whether only these are to be kept of all that have run.

        Raises:
            TrialError: a trial of the baseline's policy produced no result, or another one than the
                cache has.
        """
        self.indexes = set(indexes) if exactly else self.indexes | set(indexes)
        self._session.run_these(self.indexes)
        standing = RunStanding(first=0, followed=tuple(sorted(self.indexes)))
        is_whole = len(self.indexes) == len(self._plan.trials) or self.is_interrupted
        self._session.write_rows(None if is_whole else stop_of(self._plan, standing))
        own = self._session.info
        if own.cache is not None and own.cache.differing:
            raise TrialError(
                f"the baseline's policy {own.policy.name}: {own.cache.differing[0]}",
                fix="start a new run",
            )
        if not self.is_interrupted:
            nested = self._session.folder
            self._arm = ControlArm(run=own, rows=control_rows(nested, own, self._folder))

    def has_the_baselines_results(self) -> bool | tuple[str, ...]:
        """Return whether the trials so far have the baseline's bits; sentences where they do not.

        Only a candidate on the baseline's own starts can be asked.
        """
        assert self._arm is not None, "something has run"
        baseline, rows = self._against.results, self._arm.rows
        panel = baseline.panels[0]
        if wrong := contradictions(rows, baseline, panel):
            return wrong
        return all(
            trajectory(row)
            == panel.by_stratum[row.scene, row.perturbation][row.seed_index].trajectory
            for row in rows
        )


def baseline_bundle(plan: Plan, against: LoadedBaseline, run: RunInfo) -> Bundle:
    """Return the baseline's policy: where the request says, or the baseline.

    Raises:
        IncomparableError: it is not there, cannot be used, or is another one.
    """
    from nw_policies import find_card, load_bundle
    from nw_sim.rollout.confined.vetting import vet_bundle

    own = against.results.manifest.policy
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
        f"baseline {against.info.name} has no results for this machine type, and its policy "
        f"{own.name} cannot be run on it: {fault}",
        fix="name its card with --baseline-policy PATH, or save the baseline on this machine: "
        f"`{renewing(run, against.results)}`",
    )
