"""What a run would be: suite, policy and scenes resolved and checked before anything runs.

Everything that is wrong with them is found in one go.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.errors import NwEvalError, Problem, SuiteError, UsageError, nearest
from nw_eval.api.loaded_baselines import check_rounds, wanted_baseline
from nw_eval.engine.how import How
from nw_gate.results.request import Request

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_base.trials import DrawnStart
    from nw_base.words import Arm, Collision
    from nw_eval.engine.plan import Forecast, Plan
    from nw_eval.suite import Draft, Suite, Trial
    from nw_gate.results.baseline import LoadedBaseline, Stratum
    from nw_gate.results.provenance import PolicyInfo
    from nw_policies import Bundle
    from nw_scenes import Scene
    from nw_scenes.finding import SceneFinding
    from nw_scenes.robots import FoundRobot
    from nw_sim.catalogue import FoundScene


def plan(request: Request | Suite | str | Path | None, **changes: Any) -> Plan:
    """Resolve a request to the trials that it means, and check all of it.

    Args:
        request: the request, or its suite: a file, the name of a shipped one, or one that was read
            already.
        changes: fields of `Request` by name.

    Raises:
        UsageError: an option cannot be used, there is no such suite, or the policy needs images of
            a scene that has no splat.
        SuiteError: what is wrong with the suite, its scenes and its policy, all of it.
        PolicyError: only the policy cannot be used, and its own files are to blame.
    """
    return _planned(request, changes, may_fail=True)


def _planned(
    request: Request | Suite | str | Path | None, changes: dict[str, Any], *, may_fail: bool
) -> Plan:
    from nw_eval.suite import Suite, draft_of, draft_suite

    if isinstance(request, Suite):
        return plan_of(Request.of(None, **changes), draft_of(request), may_fail=may_fail)
    request = Request.of(request, **changes)
    if request.suite is None:
        raise UsageError("no suite is named", fix="name one, such as `nw-eval run hurdles`")
    return plan_of(request, draft_suite(request.suite), may_fail=may_fail)


def plan_of(
    request: Request,
    draft: Draft,
    *,
    card: Path | None = None,
    scenes: Sequence[str] | None = None,
    bundle: Bundle | None = None,
    against: LoadedBaseline | None = None,
    arm: Arm = "candidate",
    own_policy: bool | None = None,
    may_fail: bool = True,
) -> Plan:
    """Resolve a request for a suite, as `plan` does.

    Args:
        request: the options given.
        draft: the suite, as far as it could be read.
        card: where its policy lies, if that is known: a run that is resumed elsewhere still names
            its policy as it was asked for, and finds it where it was.
        scenes: globs in place of the request's.
        bundle: a policy that is loaded already, in place of the request's.
        against: a baseline that is read already, in place of the request's.
        arm: whether its policy is the one that is judged.
        own_policy: whether the policy is the suite's own; None = the request says.
        may_fail: whether a policy that answers zeros with NaN is left to its trials, which count
            it as the policy's own failure; else it is a fault.

    Raises:
        IncomparableError: the baseline does not hold for it.
    """
    from nw_eval.engine.identity import policy_info
    from nw_eval.engine.order import shard_of
    from nw_eval.engine.plan import Plan
    from nw_eval.engine.prepare import check_splats
    from nw_eval.suite import expand, override, with_robot
    from nw_eval.suite.model import plugin_faults

    faults = Faults(draft)
    robot = _robot_of(draft, faults, request)
    suite = None if draft.suite is None else override(draft.suite, request)
    if suite is not None:
        faults.extend(plugin_faults(suite))
        _vet_scores(suite, faults, allow_code=request.allow_code)
        if robot is not None:
            suite = with_robot(suite, robot.reference)
    if own_policy is None:
        own_policy = bundle is None and _is_own_policy(draft, request)
    # A process of its own reads the baseline, for no longer than an interrupt can wait.
    with ThreadPoolExecutor(max_workers=1) as beside:
        read = None
        if suite is not None and against is None:
            read = beside.submit(wanted_baseline, request, suite, own_policy=own_policy)
        known_scenes = open_scenes(draft, faults, request.collision)
        for found_scene in known_scenes:
            _ = (
                found_scene.scene.digest
            )  # Kept; the process that checks the policy is still starting.
        if bundle is None:
            bundle = open_policy(draft, faults, request, robot=robot, card=card, may_fail=may_fail)
        else:
            bundle = _vet_policy(draft, faults, request, bundle, robot=robot, may_fail=may_fail)
    _check_task(suite, bundle, faults)
    _vet_ladders(suite, bundle, faults)
    _check_pictures(suite, request, faults)
    faults.raise_any()
    assert suite is not None, "a suite that cannot be used has faults"
    assert bundle is not None, "a policy that cannot be used has faults"
    chosen = chosen_scenes(known_scenes, request.scenes if scenes is None else scenes, suite)
    opened = [found_scene.scene for found_scene in chosen]
    check_splats(bundle.card, opened)
    if read is not None:
        against = read.result()
    policy = policy_info(bundle)
    suite = _on_panel(request, suite, opened, policy, against)
    trials, shard = shard_of(
        expand(suite, opened, _drawn(request, suite, opened, policy, against)), request.part
    )
    if suite.plugins or any(dict(trial.perturbation) for trial in trials):
        _try_axes(trials, suite, bundle)
    folder = None if robot is None else robot.folder
    if folder is not None:  # Who goes on with the run finds it by its path.
        request = replace(request, robot=str(folder))
    resolved = Plan(
        request=request.from_anywhere(),
        suite=suite,
        bundle=bundle,
        found=chosen,
        left_out=tuple(
            sorted(
                {found_scene.scene.name for found_scene in known_scenes}
                - {found_scene.scene.name for found_scene in chosen}
            )
        ),
        trials=trials,
        own_policy=own_policy,
        shard=shard,
        against=against,
        arm=arm,
        robot_folder=folder,
    )
    return resolved if against is None else _matched(resolved, against)


def _check_task(suite: Suite | None, bundle: Bundle | None, faults: Faults) -> None:
    """Tell where a suite's task does not fit its policy or its episode, if both could be read."""
    from nw_scenes.robots import get_robot
    from nw_sim.axes import COMMANDED
    from nw_sim.rollout.asked_for import own_targets
    from nw_sim.tasks import TaskRules, fault_of
    from nw_sim.tasks.commanded import is_commanded, with_command

    if suite is None or bundle is None:
        return
    task, own = suite.task, None
    if getattr(task, "targets", None) is not None:
        with suppress(NwEvalError):  # As already reported.
            own = own_targets(bundle.card, get_robot(suite.robot))
    if task.kind == "track" and bundle.card.reference is not None:
        _vet_motion(suite, bundle, faults)
    rules = TaskRules(duration=suite.episode.duration, own=own)
    axes = [axis for axis in suite.perturb.axes if axis in COMMANDED]
    if axes and not is_commanded(task):
        message = f"perturb.{axes[0]}: the task {task.kind} has no velocity command to change"
        fix = "use task: velocity, or remove the axis"
        faults.extend([suite.source.problem(("perturb", axes[0]), message, fix)])
        return
    for cell in suite.perturb.cells:
        parts = {COMMANDED[axis]: value for axis, value in cell if axis in COMMANDED}
        try:
            fault = fault_of(with_command(task, parts), hears=bundle.card.hears, rules=rules)
        except NwEvalError:  # Its package is missing or broken, as already reported.
            return
        if fault is not None:
            at = ("perturb", axes[0]) if axes else ("task", *fault.location)
            location = ".".join(map(str, at))
            faults.extend([suite.source.problem(at, f"{location}: {fault.message}", fault.fix)])
            return


def _vet_motion(suite: Suite, bundle: Bundle, faults: Faults) -> None:
    """Tell what is wrong with the motion of a suite, or of its policy's card."""
    from nw_sim.rollout.confined.vetting import vet_motion
    from nw_sim.tasks.track import NAMED, with_motion

    if suite.motion is None and bundle.motion is None:
        message = "task: neither the suite nor the policy's card names a motion"
        faults.extend([suite.source.problem(("task",), message, NAMED)])
        return
    task = with_motion(suite.task, lambda file: str((suite.base / file).absolute()))
    try:
        vet_motion(bundle, suite.robot, getattr(task, "motion", None))
    except NwEvalError as error:
        if suite.motion is None:
            faults.add(error)
            return
        place = ("task", "motion", "file")
        text = f"task.motion.file: {error.message}"
        faults.extend([suite.source.problem(place, text, error.fix)])


def _check_pictures(suite: Suite | None, request: Request, faults: Faults) -> None:
    """Tell where the backend cannot draw what a suite asks for."""
    from nw_sim.rendering import PUBLISHED

    if suite is None or request.render != "cuda" or suite.render == PUBLISHED:
        return
    said = f"{suite.render.projection}, samples {suite.render.samples}, near {suite.render.near:g}"
    faults.extend(
        [
            suite.source.problem(
                ("render",),
                f"render: --render cuda draws with ewa, samples 1 and near 0.01, not with {said}",
                "use --render cpu",
            )
        ]
    )


def _vet_scores(suite: Suite, faults: Faults, *, allow_code: bool) -> None:
    """Tell which functions of a suite cannot be read, or may not run."""
    from nw_base.errors import CodeError

    try:
        suite.measured_by()
    except NwEvalError as error:
        faults.add(error)
    for own in () if allow_code else suite.own_scores:
        faults.add(
            CodeError(
                f"score {own.spec.name!r} is Python code, {own.python}",
                fix="add --allow-code if you trust it",
            )
        )


def _vet_ladders(suite: Suite | None, bundle: Bundle | None, faults: Faults) -> None:
    """Tell which ladders of a suite's gate cannot be climbed by its policy, if that can be read."""
    if suite is not None and suite.gate.limits:
        from nw_eval.suite.ladders import ladder_faults

        for location, error in ladder_faults(suite, None if bundle is None else bundle.card.hears):
            faults.at(location, error)


def _try_axes(trials: Sequence[Trial], suite: Suite, bundle: Bundle) -> None:
    """Let axes change the setup of a trial of each cell, before anything runs.

    Raises:
        PluginError: one of a package cannot.
        UsageError: a camera cannot see so wide an angle, or the task has no command to change.
    """
    from nw_policies.cards import mounted_robot
    from nw_scenes.robots import get_robot
    from nw_sim.rollout.perturbed import TrialSetup, perturbed
    from nw_sim.tasks.commanded import with_command

    robot = mounted_robot(get_robot(suite.robot), bundle.card)
    for cell, trial in {trial.perturbation: trial for trial in trials}.items():
        setup = perturbed(TrialSetup.of(trial, robot, bundle.card), dict(cell))
        with_command(suite.task, setup.command)


def baseline_plan(plan: Plan, bundle: Bundle) -> Plan:
    """Return the plan of a baseline's own policy from a candidate's starts, in its order.

    Of a part of a run it is that of the whole run.

    Args:
        plan: the candidate's.
        bundle: the baseline's policy.

    Raises:
        UsageError: it needs images of a scene that has no splat.
    """
    from nw_eval.engine.identity import policy_info
    from nw_eval.engine.plan import DrawnOrder
    from nw_eval.engine.prepare import check_splats
    from nw_eval.suite import expand, override

    check_splats(bundle.card, plan.scenes)
    request = replace(
        plan.request, policy=bundle.reference, checkpoint=None, record="none", shard=None
    )
    policy, trials = policy_info(plan.bundle), plan.trials
    if plan.shard is not None:
        drawn = _drawn(plan.request, plan.suite, plan.scenes, policy, plan.against)
        trials = expand(plan.suite, plan.scenes, drawn)
    return replace(
        plan,
        request=request,
        suite=override(plan.suite, Request(record="none")),
        bundle=bundle,
        trials=trials,
        shard=None,
        drawn=DrawnOrder(starts=plan.drawn_from, candidate=policy.key),
        is_baseline=False,
        arm="baseline",
    )


def rechecked(plan: Plan, seed: int, *, all_rounds: bool = False) -> Plan:
    """Return the plan of a baseline's own policy with trials that run in spite of the cache.

    Args:
        plan: with `is_baseline`.
        seed: draws the starts of each scene that run again.
        all_rounds: whether all trials run, in the order that they have.

    Raises:
        IncomparableError: the baseline has fewer starts than are to run again.
    """
    from nw_eval.engine.identity import policy_info
    from nw_eval.engine.order import draw
    from nw_eval.engine.plan import DrawnOrder
    from nw_eval.suite import expand, override
    from nw_gate.baseline.match import draw_rounds
    from nw_gate.results.provenance import candidate_in, recheck_key, rounds_key

    assert plan.against is not None, "a baseline policy's plan has a baseline"
    count, against = rechecks(plan.request), plan.against
    starts = against.results.manifest.starts
    strata = _strata(plan.suite, plan.scenes)
    if all_rounds and plan.shard is None:
        key = rounds_key(policy_info(plan.bundle))
        order = draw_rounds(
            strata,
            starts,
            plan.suite.trials,
            candidate=candidate_in(key),
            suite_digest=plan.suite.digest,
        )
        plan = replace(
            plan,
            trials=expand(plan.suite, plan.scenes, order),
            drawn=DrawnOrder(starts=starts, candidate=key),
        )
    if all_rounds:
        groups: dict[tuple[object, ...], list[str]] = {}
        for trial in plan.trials:
            groups.setdefault((trial.scene, trial.perturbation), []).append(trial.id)
        drawn_names = (draw(names, str(count), seed) for names in groups.values())
        trial_ids = frozenset(name for names in drawn_names for name in names)
        return replace(plan, is_baseline=False, again=trial_ids)
    suite = override(plan.suite, Request(trials=max(plan.suite.trials, count)))
    check_rounds(against, suite.trials, suite, plan.request)
    key = recheck_key(seed)
    drawn = DrawnOrder(starts=starts, candidate=key)
    order = draw_rounds(strata, starts, suite.trials, candidate=key, suite_digest=suite.digest)
    trials = expand(suite, plan.scenes, order)
    trial_ids = frozenset(trial.id for trial in trials[: count * len(strata)])
    return replace(plan, suite=suite, trials=trials, drawn=drawn, again=trial_ids)


def rechecks(request: Request) -> int:
    """Return how many starts of each scene run again of a baseline's own policy."""
    return 1 if request.recheck is None else request.recheck


def _strata(suite: Suite, scenes: Sequence[Scene]) -> list[Stratum]:
    return [(scene.name, cell) for scene in scenes for cell in suite.perturb.cells]


def _on_panel(
    request: Request,
    suite: Suite,
    scenes: Sequence[Scene],
    policy: PolicyInfo,
    against: LoadedBaseline | None,
) -> Suite:
    """Return a suite with the seed of the seed set in use, and the trials that may run."""
    from nw_eval.suite import override
    from nw_gate.baseline.match import fresh_seed

    seed = fresh_seed(policy, suite.model_dump(by_alias=True)) if request.panel == "fresh" else None
    rounds = None
    if against is not None and request.trials is None:
        known = None if request.panel == "fresh" else against.results.manifest.starts
        rounds = suite.gate.rounds_for(len(_strata(suite, scenes)), known)
    return override(suite, Request(seed=seed, trials=rounds))


def _drawn(
    request: Request,
    suite: Suite,
    scenes: Sequence[Scene],
    policy: PolicyInfo,
    against: LoadedBaseline | None,
) -> list[DrawnStart] | None:
    """Return the trials of a run against a baseline in their order; None without a baseline.

    Raises:
        IncomparableError: the baseline has fewer starts than are drawn of each scene on average.
    """
    from nw_gate.baseline.match import draw_fresh, draw_trials

    if against is None:
        return None
    strata = _strata(suite, scenes)
    order = {"candidate": policy.key, "suite_digest": suite.digest}
    if request.panel == "fresh":
        return draw_fresh(strata, suite.trials, **order)
    check_rounds(against, suite.trials, suite, request)
    return draw_trials(strata, against.results.manifest.starts, suite.trials, **order)


def _matched(plan: Plan, against: LoadedBaseline) -> Plan:
    """Return a plan that its baseline holds for, with whether its policy is the baseline's own.

    Raises:
        IncomparableError: the baseline does not fit it, or is too low for any regression.
    """
    from nw_eval.engine.provenance import run_info
    from nw_gate.baseline.finding import check_level
    from nw_gate.baseline.judge import setup_of
    from nw_gate.results.run_folder import RunFolder

    folder = RunFolder(path=Path(plan.suite.name))
    run = run_info(plan, folder, How())
    # Whether this machine type has the baseline's bits is found out by running something.
    known = against.info.model_copy(update={"checked": "bits"})
    setup = setup_of(run.model_copy(update={"baseline": known}), against, plan.suite.gate)
    # From other initial states no result can be the baseline's: its own policy is compared, too.
    is_elsewhere = plan.panel == "fresh" or against.results.manifest.held_out
    if setup.basis != "same":
        check_level(setup.panel, setup.judged, plan.suite.gate)
    elif is_elsewhere:
        setup.check_comparable()
    is_own = setup.basis == "same" and not is_elsewhere and plan.arm == "candidate"
    return replace(plan, is_baseline=is_own)


def check(
    request: Request | Suite | str | Path | None, *, workers: int | None = None, **changes: Any
) -> Forecast:
    """Return what a run would be, without running it: scenes, trials, digests, expected minutes.

    Args:
        request: as for `plan`.
        workers: processes to plan for (default: one for each core).
        changes: fields of `Request` by name.

    Raises:
        UsageError, SuiteError, PolicyError: as `plan`.
    """
    from nw_eval.engine.how import check_workers
    from nw_eval.engine.plan import forecast

    check_workers(workers)
    return forecast(_planned(request, changes, may_fail=False), workers=workers)


def chosen_scenes(
    scenes: Sequence[FoundScene], globs: Sequence[str] | None, suite: Suite
) -> tuple[FoundScene, ...]:
    """Return the scenes that match a glob; all of them if there are no globs to match."""
    from nw_sim.catalogue import is_meant

    if globs is None:
        return tuple(scenes)
    chosen = tuple(x for x in scenes if any(is_meant(x.scene.name, glob) for glob in globs))
    if not chosen:
        wanted = ", ".join(globs)
        raise UsageError(
            f"--scenes {wanted} matches no scene of suite {suite.name!r}",
            fix=nearest(
                wanted.replace("*", ""), [found_scene.scene.name for found_scene in scenes]
            ),
        )
    return chosen


class Faults:
    """What is wrong with a suite: the file's own faults first found, then whatever is added."""

    def __init__(self, draft: Draft) -> None:
        self._draft = draft
        self._problems = list(draft.problems)
        self._others: list[NwEvalError] = []

    def at(self, location: tuple[str | int, ...], error: NwEvalError) -> None:
        """Add what is wrong with something that the suite names there: a problem for each line."""
        for line in str(error).splitlines():
            self._problems.append(self._draft.source.problem(location, line, None))

    def add(self, error: NwEvalError) -> None:
        """Add what is wrong elsewhere."""
        self._others.append(error)

    def extend(self, problems: list[Problem]) -> None:
        """Add problems of the suite's file."""
        self._problems += problems

    def raise_any(self) -> None:
        """Raise what was found, if anything was: faults elsewhere alone as what they are.

        Raises:
            SuiteError: faults of the suite, and any other beside them.
            NwEvalError: the only fault, which is not the suite's.
        """
        if not self._problems and len(self._others) == 1:
            raise self._others[0]
        if self._problems or self._others:
            ordered = sorted(self._problems, key=lambda problem: (problem.line, problem.column))
            raise SuiteError(ordered, self._others)


def open_scenes(
    draft: Draft, faults: Faults, collision: Collision | None
) -> tuple[FoundScene, ...]:
    """Return the scenes that a suite names, each once, as far as they can be opened.

    Args:
        draft: the suite.
        faults: where to tell what is wrong.
        collision: how meshes collide, whatever the suite says of it.
    """
    from nw_base.errors import SceneError
    from nw_eval.suite import tier_problems
    from nw_sim import catalogue
    from nw_sim.tasks.course import start_finding

    opened: dict[tuple[str, Collision], FoundScene] = {}
    failed: list[str] = []
    for index, pattern in draft.scenes.items():
        try:
            for each in catalogue.references([pattern], draft.base, collision=collision):
                if each not in opened:
                    found_scene = opened[each] = catalogue.FoundScene.at(*each)
                    if free := start_finding(found_scene.scene):
                        faults.at(("scenes", index), _refused(found_scene.scene.name, free))
        except SceneError as error:
            faults.at(("scenes", index), error)
            failed.append(pattern)
        except OSError as error:  # No file system takes such a name.
            message = f"no scene matches {clean(pattern, at_most=60)!r}: {error.strerror}"
            faults.at(("scenes", index), SceneError(message, fix="name a scene or its folder"))
            failed.append(pattern)
    # A tier of a scene that exists, and is not run for another fault's sake, is no fault.
    meant = [found_scene.scene.name for found_scene in opened.values()]
    faults.extend(tier_problems(draft, meant + list(catalogue.names() if failed else ()), failed))
    return tuple(opened.values())


def _refused(scene: str, finding: SceneFinding) -> NwEvalError:
    from nw_base.errors import SceneError

    return SceneError(f"scene {clean(scene, at_most=100)}: {finding.message}", fix=finding.fix)


def _robot_of(draft: Draft, faults: Faults, request: Request) -> FoundRobot | None:
    """Return the robot of a request or else of the suite; None if there is none."""
    from nw_base.errors import RobotError, UsageError
    from nw_scenes.robots import find_robot

    own = draft.text("robot")
    try:
        if request.robot is not None:
            return find_robot(request.robot)
        return None if own is None else find_robot(own, draft.base)
    except RobotError as error:
        faults.add(error)
    except UsageError as error:
        if request.robot is not None:
            faults.add(UsageError(f"--robot: {error.message}", fix=error.fix))
        else:
            faults.at(("robot",), error)
    return None


def open_policy(
    draft: Draft,
    faults: Faults,
    request: Request,
    *,
    robot: FoundRobot | None,
    card: Path | None,
    may_fail: bool,
) -> Bundle | None:
    """Return the policy of a request or else of the suite, checked; None if it cannot be used.

    Args:
        draft: the suite.
        faults: where to tell what is wrong.
        request: options that replace the suite's own.
        robot: that the suite runs; None = its own fault is already reported.
        card: where the policy lies, if that is known.
        may_fail: as for `vet_bundle`.
    """
    from nw_base.errors import PolicyError
    from nw_policies import find_card, load_bundle
    from nw_policies.cards.load import UNKNOWN_ROBOT

    own = draft.text("policy")
    named = request.policy if card is None else str(card)
    if named is None and own is None:
        return None  # The file's own fault says so.
    try:
        path = find_card(_from_base(draft.base, own or "") if named is None else named)
    except PolicyError as error:
        if named is None:
            faults.at(("policy",), error)
        else:
            faults.add(error)
        return None
    try:
        bundle = load_bundle(path, checkpoint=request.checkpoint)
    except NwEvalError as error:
        kept = [each for each in error.problems if not each.message.startswith(UNKNOWN_ROBOT)]
        if robot is not None or len(kept) == len(error.problems):
            faults.add(error)
        elif kept:  # The card's robot is the one whose fault is told.
            faults.add(PolicyError(kept))
        return None
    return _vet_policy(draft, faults, request, bundle, robot=robot, may_fail=may_fail)


def _is_own_policy(draft: Draft, request: Request) -> bool:
    """Return whether the policy of a request is the suite's own, also by another path to its card.

    With other weights for its card (`checkpoint`) it is a candidate instead of the suite's
    own, and counts as that.

    Args:
        draft: the suite.
        request: the options given.
    """
    from nw_base.errors import PolicyError
    from nw_policies import find_card

    own, named = draft.text("policy"), request.policy
    if named is None:
        return True
    if own is None or any(each.startswith("hub:") for each in (own, named)):
        return named == own
    try:
        return find_card(named).samefile(find_card(_from_base(draft.base, own)))
    except (PolicyError, OSError):
        return False


def _vet_policy(
    draft: Draft,
    faults: Faults,
    request: Request,
    bundle: Bundle,
    *,
    robot: FoundRobot | None,
    may_fail: bool,
) -> Bundle | None:
    """Return a policy that is loaded already, checked; None if it cannot be used.

    Args:
        draft: the suite.
        faults: where to tell what is wrong.
        request: options that replace the suite's own.
        bundle: the policy.
        robot: that the suite runs; None = its own fault is already reported.
        may_fail: as for `vet_bundle`.
    """
    from nw_base.protocol import PROTOCOLS, STRICT
    from nw_sim.rollout.confined.vetting import vet_bundle

    try:
        return vet_bundle(
            bundle,
            bundle.card.robot if robot is None else robot.reference,
            protocol=PROTOCOLS.get(draft.text("protocol") or "", STRICT),
            allow_code=request.allow_code,
            may_fail=may_fail,
        )
    except NwEvalError as error:
        faults.add(error)
        return None


def _from_base(base: Path, policy: str) -> str:
    """Return what names a suite's own policy: its relative path starts from the suite's folder."""
    own = base / policy
    return str(own) if ("/" in policy or own.suffix == ".yaml") and own.exists() else policy
