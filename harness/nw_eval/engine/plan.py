"""From trials to jobs: everything that a worker needs to know, decided before the first starts.

And what a run of them would be, and about how long it would take (`Forecast`).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from math import ceil
from typing import TYPE_CHECKING

from nw_base.plugins import SPLAT_FORMATS, code_named, identity_of, key_of
from nw_base.plural import plural
from nw_eval.engine.identity import engine_of
from nw_eval.engine.machine import worker_count
from nw_eval.engine.order import in_order
from nw_eval.engine.prepare import needs_splats
from nw_eval.suite import suite_yaml
from nw_gate.results.baseline import machine_in
from nw_sim.rollout.job import TrialJob, kernels_of
from nw_sim.rollout.record import attachments
from nw_sim.tasks.track import with_motion

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from nw_base.trials import DrawnStart, Trial
    from nw_base.words import Arm, Backend, Kernels, PanelKind
    from nw_eval.suite.model import Suite
    from nw_gate.results.baseline import LoadedBaseline
    from nw_gate.results.column import Settings
    from nw_gate.results.provenance import ShardInfo
    from nw_gate.results.request import Request
    from nw_gate.results.run_folder import RunFolder
    from nw_policies import Bundle
    from nw_scenes import Scene
    from nw_sim.catalogue import FoundScene

# Wall seconds for each simulated second, and on top for the first compilation of kernels: many
# times what a trial takes on a slow core with a large camera, so that only what never ends is hung.
_SECONDS_PER_SECOND = 20.0
_SECONDS_MORE = 90.0


@dataclass(frozen=True, kw_only=True)
class DrawnOrder:
    """An order of the starts of a baseline that is not the policy's own.

    Attributes:
        starts: of the baseline, in each scene; None where fresh ones are met.
        candidate: for whom it was drawn, by the `key` of another policy, or `recheck_key`.
    """

    starts: int | None
    candidate: str


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run is to be: everything resolved and checked, nothing run."""

    request: Request
    suite: Suite  # with the request's changes; with a baseline `trials` is the most of each scene
    bundle: Bundle
    found: tuple[FoundScene, ...]
    trials: tuple[Trial, ...]  # that are to be run here: of a shard, its own
    left_out: tuple[str, ...] = ()
    """Scenes of the suite that are not to be run, by name."""
    own_policy: bool = True
    """Whether the policy is the suite's own: only then its own baseline counts."""
    shard: ShardInfo | None = None
    """Which part of a run it is; None: all of it."""
    against: LoadedBaseline | None = None
    is_baseline: bool = False
    """Whether the policy to be judged is the baseline's own, on the baseline's starts, of which
    only some need run again."""
    again: frozenset[str] = frozenset()
    """Trials that run though the cache of trials has their results."""
    drawn: DrawnOrder | None = None
    """Whose order the trials are in, if not in one of the policy's own."""
    arm: Arm = "candidate"
    robot_folder: Path | None = None
    """Where the suite's robot lies, if that is a folder."""

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The scenes of its trials."""
        return tuple(found.scene for found in self.found)

    @property
    def panel(self) -> PanelKind:
        """Which starts the policy meets."""
        return self.request.panel or "pinned"

    @property
    def drawn_from(self) -> int | None:
        """Starts of the baseline that drew the order of the trials; None if none did."""
        if self.drawn is not None:
            return self.drawn.starts
        if self.against is None or self.panel == "fresh":
            return None
        return self.against.results.manifest.starts

    @property
    def plugins(self) -> dict[str, str]:
        """What installed packages bring along to its trials: `KEY: package version sha256`.

        Functions of the suite are among them: `scores.NAME: file.py:function sha256`.
        """
        from nw_scenes.folder import FileSplat
        from nw_splat.files import package_format

        of_suite = {
            key: f"{said} {code_named(key)}".strip() for key, said in self.suite.plugins.items()
        }
        of_scenes = {
            key_of(SPLAT_FORMATS, name): identity_of(SPLAT_FORMATS, name)
            for name in (
                package_format(scene.splat.path)
                for scene in self.scenes
                if isinstance(scene.splat, FileSplat)
            )
            if name is not None
        }
        return dict(
            sorted({**self.bundle.plugins, **of_suite, **of_scenes, **self.suite.own_code}.items())
        )

    @property
    def render(self) -> Backend:
        """The splat renderer."""
        return "cpu" if self.request.render is None else self.request.render

    @property
    def renders(self) -> bool:
        """Whether any trial may render."""
        return needs_splats(self.bundle.card, self.suite.record)

    @property
    def kernels(self) -> tuple[Kernels, ...]:
        """Which kernels of the CPU draw its pictures, run its networks and cast its rays."""
        projections = (self.suite.render.projection,) if self.renders else ()
        return kernels_of(self.suite.robot, self.bundle.card, *projections)

    @property
    def time_limit(self) -> float:
        """Wall seconds after which a trial counts as hung."""
        limit = self.request.time_limit
        return default_time_limit(self.suite.episode.duration) if limit is None else limit

    @property
    def memory_limit(self) -> int | None:
        """Bytes that a worker may hold with its children; None = as many as there are."""
        return self.request.memory_bytes


def default_time_limit(duration: float) -> float:
    """Return the wall seconds after which a trial of `duration` simulated s counts as hung."""
    return _SECONDS_MORE + _SECONDS_PER_SECOND * duration


def plan_jobs(plan: Plan, folder: RunFolder) -> tuple[TrialJob, ...]:
    """Return the jobs of a run in the order in which they are to be started.

    Args:
        plan: what is to be run.
        folder: where logs go.
    """
    suite, bundle = plan.suite, plan.bundle
    places = {found.scene.name: found for found in plan.found}
    attached = attachments(bundle.card_text, suite_yaml(suite))
    return tuple(
        TrialJob(
            trial=trial,
            robot=suite.robot,
            robot_folder=plan.robot_folder,
            protocol=suite.protocol,
            task=with_motion(suite.task, lambda file: str((suite.base / file).absolute())),
            scores=suite.measured_by(),
            duration=suite.episode.duration,
            contact_termination=suite.episode.contact_termination,
            scene=places[trial.scene].reference,
            collision=places[trial.scene].collision,
            policy=bundle.reference,
            policy_name=bundle.name,
            checkpoint=plan.request.checkpoint,
            checkpoint_digest=bundle.checkpoint_digest,
            operator=bundle.operator,
            allow_code=plan.request.allow_code,
            record=suite.record,
            mcap=folder.mcap(trial.scene, trial.id).resolve(),
            render=plan.render,
            rendering=suite.render,
            time_limit=plan.time_limit,
            attachments=attached,
        )
        for trial in in_order(plan.trials)
    )


# Wall seconds for one simulated second of a trial that lasts its whole duration, on one core of the
# class that the benchmarks name: physics, scandots, policy and log, and a camera's frames on top.
_BLIND = 0.06
_SEEING = 0.10
# Wall seconds until a worker has its libraries and kernels.
_START = 4.0
_LEAST = 0.1  # minutes
# Trials of each scene on a fresh seed set up to which it is asked whether a gate can pass.
_MOST_FRESH = 100


@dataclass(frozen=True, kw_only=True)
class SceneForecast:
    """A scene that would be run."""

    name: str
    digest: str
    """Hex sha256 of its physics; part of its trials' identity."""
    trials: int


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """A run that has not been run."""

    suite: Suite
    """With what was asked of it otherwise; it has a digest of its seed set and one of all it
    says."""
    policy: Bundle
    scenes: tuple[SceneForecast, ...]
    left_out: tuple[str, ...] = ()
    """Scenes of the suite that are not to be run, by name."""
    shard: ShardInfo | None = None
    """Which part of a run it is, in trials and minutes too; None: all of it."""
    workers: int
    baseline: str | None = None
    """The name of the baseline that it would be compared with; it may then end early."""
    obstacles: tuple[str, ...] = ()
    """Why no policy can reach PASS in it, a sentence for each reason; none where one can."""
    warnings: tuple[str, ...] = ()
    """What makes the verdict another one than its reader expects, a sentence each."""
    power: str | None = None
    """How its gate ends for an equal policy and for worse ones, by simulation; None without a
    baseline, or where nothing can be dropped."""
    minutes: float
    """Of wall time; about what it takes at most, on a core of the benchmarks' class."""

    @property
    def trials(self) -> int:
        """How many there would be."""
        return sum(scene.trials for scene in self.scenes)


def forecast(plan: Plan, *, workers: int | None = None) -> Forecast:
    """Return what a run of a plan would be.

    Args:
        plan: what would be run.
        workers: processes (default: one for each core).
    """
    trials = Counter(trial.scene for trial in _expected(plan))
    return Forecast(
        suite=plan.suite,
        policy=plan.bundle,
        scenes=tuple(
            SceneForecast(name=scene.name, digest=scene.digest, trials=trials[scene.name])
            for scene in plan.scenes
        ),
        left_out=plan.left_out,
        shard=plan.shard,
        workers=worker_count(workers, trials.total()),
        baseline=None if plan.against is None else plan.against.info.name,
        obstacles=obstacles_of(plan),
        warnings=_warnings(plan),
        power=_power(plan),
        minutes=minutes_of(
            trials.total() + sum(ladder.trials for ladder in plan.suite.gate.limits.values()),
            plan,
            workers=workers,
        ),
    )


def _expected(plan: Plan) -> tuple[Trial, ...]:
    """Return the trials that would run; of the baseline's own policy, those that run again."""
    machine = machine_in(engine_of(plan.render, plan.suite.plugins, plan.bundle.card))
    if not plan.is_baseline or plan.against is None or not plan.against.results.panel_of(machine):
        return plan.trials
    again = 1 if plan.request.recheck is None else plan.request.recheck
    met: Counter[tuple[str, Settings]] = Counter()
    found: list[Trial] = []
    for trial in plan.trials:
        met[trial.scene, trial.perturbation] += 1
        if met[trial.scene, trial.perturbation] <= again:
            found.append(trial)
    return tuple(found)


def obstacles_of(plan: Plan) -> tuple[str, ...]:
    """Return why not even a policy that never fails would pass; nothing where one would.

    A part of a run is asked about as the run that it is a part of.

    Args:
        plan: what would be run.
    """
    from nw_gate.baseline.power_forecast import bar_obstacles

    suite, against = plan.suite, plan.against
    if suite.gate.success_rate is None and against is None:
        return ()  # Without a bar or a baseline the verdict is RAN.
    unknown = () if against is None else _scores_it_lacks(plan, against)
    # Of the baseline's own policy nothing runs: the scores of its starts are judged.
    known = None if against is None or not plan.is_baseline else against.results.manifest.starts
    found = bar_obstacles(
        suite.gate,
        [scene.name for scene in plan.scenes],
        plan.left_out,
        trials=suite.trials if known is None else known,
        cells=len(suite.perturb.cells),
        against=against is not None,
    )
    if against is not None and not found and known is None:
        found += _against_the_baseline(plan, against)
    return (*unknown, *found)


def _scores_it_lacks(plan: Plan, against: LoadedBaseline) -> tuple[str, ...]:
    """Return which gated scores a baseline was saved without, that holds on this machine type.

    On another one its policy runs beside the candidate, and is measured, too.
    """
    from nw_gate.baseline.scores import lacks_score

    baseline = against.results
    engine = engine_of(plan.render, plan.suite.plugins, plan.bundle.card)
    if baseline.panel_of(machine_in(engine)) is None:
        return ()
    fix = "save it again with this suite: `nw-eval baseline save SUITE --policy POLICY --renew`"
    return tuple(
        f"{lacks_score(baseline, name)}: {fix}"
        for name, asked in plan.suite.gate.scores.items()
        if asked.max_drop is not None and name not in baseline.manifest.scores
    )


def _power(plan: Plan) -> str | None:
    """Return what the gate against the baseline can tell apart with the trials of a plan."""
    from nw_base.errors import IncomparableError
    from nw_gate.baseline.power_forecast import in_a_sentence, outset_of_baseline

    against, gate = plan.against, plan.suite.gate
    if against is None or plan.is_baseline:
        return None
    names = {scene.name for scene in plan.scenes}
    panel = against.results.panels[0]
    panel = replace(panel, starts=tuple(x for x in panel.starts if x.scene in names))
    judged = sum(gate.tier(scene.name) != "informational" for scene in plan.scenes)
    budget = plan.suite.trials * judged * len(plan.suite.perturb.cells)
    try:
        outset = outset_of_baseline(panel, gate, budget=budget, against=gate.claim)
    except IncomparableError:
        return None  # The run says why.
    return in_a_sentence(outset.power_forecast(), outset.budget)


def _warnings(plan: Plan) -> tuple[str, ...]:
    """Return that the bar is above what the baseline's own policy scores, if it is."""
    from nw_gate.results.baseline import baseline_mean

    bar, against = plan.suite.gate.success_rate, plan.against
    if bar is None or against is None or (mean := baseline_mean(against.results)) >= bar:
        return ()
    sentence = (
        f"gate.success_rate {bar:g} is above the success of baseline {against.info.name}, "
        f"{mean:.3f}: a policy that is as good as the baseline does not pass"
    )
    return (sentence,)


def _against_the_baseline(plan: Plan, against: LoadedBaseline) -> list[str]:
    """Return that the trials of a plan are too few to exclude max_drop, if they are."""
    from nw_gate.baseline.power_forecast import trials_to_pass_baseline

    suite, manifest, panel = plan.suite, against.results.manifest, against.results.panels[0]
    fresh = plan.drawn_from is None
    order, scenes = _whole_order(plan, against), len(plan.scenes) * len(suite.perturb.cells)
    needed = trials_to_pass_baseline(suite.gate, panel, order, fresh=fresh)
    if needed is not None and needed <= suite.trials * scenes:
        return []
    most = len(order) // scenes
    if needed is None:
        states = plural(manifest.starts, "initial state")
        fix = f"the baseline has no more than {states} in each scene"
        if fresh:
            fix = f"{most} in each scene cannot either"
    else:
        least = ceil(needed / scenes)
        fix = f"--trials {least} (`gate.rounds: {least}`) is the least that can"
    reason = (
        f"{plural(suite.trials * scenes, 'trial')} against baseline {against.info.name} cannot "
        f"exclude a drop of {suite.gate.most_drop:g} even if all are perfect: {fix}"
    )
    return [reason]


def obstacles_among_equals(
    suite: Suite, scenes: Sequence[str], left_out: Collection[str]
) -> tuple[str, ...]:
    """Return why of two policies that never fail, from the same starts, the second would not pass.

    Args:
        suite: whose trials both run; the first is the baseline.
        scenes: that are run, by name.
        left_out: scenes of the suite that are not, by name.
    """
    from nw_gate.baseline.match import draw_trials
    from nw_gate.baseline.power_forecast import (
        bar_obstacles,
        perfect_panel,
        trials_to_pass_baseline,
    )

    gate, cells = suite.gate, suite.perturb.cells
    if gate.success_rate is not None:
        found = bar_obstacles(gate, scenes, left_out, trials=suite.trials, cells=len(cells))
        if found:
            return tuple(found)
    strata = [(scene, cell) for scene in scenes for cell in cells]
    if all(gate.tier(scene) == "informational" for scene in scenes):
        return ()

    def needed(starts: int) -> int | None:
        order = draw_trials(
            strata, starts, starts, candidate=suite.digest, suite_digest=suite.digest
        )
        return trials_to_pass_baseline(gate, perfect_panel(strata, starts), order, fresh=False)

    if needed(suite.trials) is not None:
        return ()
    enough = needed(max(_MOST_FRESH, suite.trials))
    least = None if enough is None else ceil(enough / len(strata))
    fix = f"{_MOST_FRESH} in each scene cannot either"
    if least is not None:
        fix = f"--trials {least} (`trials: {least}`) is about the least that can"
    reason = (
        f"{plural(suite.trials * len(strata), 'trial')} cannot exclude a drop of "
        f"{gate.most_drop:g} from the best checkpoint even if all of both are perfect: {fix}"
    )
    return (reason,)


def _whole_order(plan: Plan, against: LoadedBaseline) -> list[DrawnStart]:
    """Return the order of a plan with as many trials as there can be."""
    from nw_eval.engine.identity import policy_info
    from nw_gate.baseline.match import draw_fresh, draw_trials

    suite, most = plan.suite, against.results.manifest.starts
    strata = [(scene.name, cell) for scene in plan.scenes for cell in suite.perturb.cells]
    drawn_by = {"candidate": policy_info(plan.bundle).key, "suite_digest": suite.digest}
    if plan.drawn_from is None:
        return draw_fresh(strata, max(_MOST_FRESH, suite.trials), **drawn_by)
    return draw_trials(strata, most, most, **drawn_by)


def minutes_of(trials: float, plan: Plan, *, workers: int | None = None) -> float:
    """Return about how many minutes of wall time so many trials of a plan's kind take at most.

    Args:
        trials: how many, whatever the plan has.
        plan: whose suite and policy they are of.
        workers: processes (default: one for each core).
    """
    sees = bool(plan.bundle.card.splat_images) or plan.suite.record == "all"
    each = (_SEEING if sees else _BLIND) * plan.suite.episode.duration
    count = worker_count(workers, ceil(trials))
    return max((_START + each * trials / count) / 60.0, _LEAST)
