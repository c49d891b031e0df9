"""Running a policy through a suite: one by name, or an object that a training loop has at hand."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from nw_base.errors import UsageError
from nw_base.files.traceback_file import TracebackIn
from nw_base.plural import plural
from nw_eval.api.paths import as_path
from nw_eval.api.plans import plan
from nw_eval.api.reports import RunReport, prepare_pages, report_here
from nw_eval.engine.how import How, check_limits
from nw_gate.results.request import Request
from nw_sim.rollout.confined.start import prepare

if TYPE_CHECKING:
    from collections.abc import Iterator
    from os import PathLike

    from nw_eval.engine.plan import Plan
    from nw_gate.results.provenance import ShardInfo
    from nw_gate.results.run_folder import RunFolder
    from nw_policies import Bundle
    from nw_policies.cards import Card
    from nw_policies.policy import Observation
    from nw_scenes.finding import SceneFinding


def run(
    request: Request | str | Path | None = None,
    *,
    out: str | PathLike[str] | None = None,
    resume: str | PathLike[str] | None = None,
    **changes: Any,
) -> RunReport:
    """Roll a checkpoint out through a suite, write the evidence, and judge it.

    `run("hurdles", policy="stand")` is `run(Request(suite="hurdles", policy="stand"))`.

    Args:
        request: what to run, or only its suite: a file or the name of a shipped one; None only
            with `resume`.
        out: the run's folder (default: a new one in `reports/`).
        resume: the folder of an interrupted run, whose finished trials are kept. What the request
            does not ask for is as the run was begun, but for leave to run code.
        changes: fields of `Request` and of `How` by name.

    Raises:
        UsageError, SuiteError, SceneError, PolicyError, PrerequisiteError: nothing was run.
        IncomparableError: the run to resume was made under something else.
        StoreError: results cannot be written; those that were written stay.
    """
    from nw_eval.api.continuing import continued

    out = as_path(out)
    resume = as_path(resume)
    how = How.taken_from(changes)
    if resume is not None and out is not None:
        raise UsageError("--out and --resume exclude each other", fix="drop --out")
    request = Request.of(request, **changes)
    how.check_in_process(request)
    if not how.in_process and how.cluster is None and not request.allow_code:
        prepare()  # It takes as long as planning does.
    planned = plan(request) if resume is None else continued(resume, request)
    return judged(roll_out(planned, how, out=out, resume=resume))


def roll_out(
    plan: Plan,
    how: How,
    *,
    out: Path | None = None,
    resume: Path | None = None,
    ladders: bool = True,
) -> RunFolder:
    """Run what is planned: against a baseline, trial by trial, until bar and baseline are settled.

    A part of a run has all its trials: whether some are enough shows in the whole alone. Of the
    baseline's own policy some starts of each scene run, and the others are taken from the baseline
    if these are as it says.

    Args:
        plan: what is to be run.
        how: how it is run.
        out: the run's folder (default: a new one in `reports/`).
        resume: the folder of an interrupted run.
        ladders: whether the ladders of its gate are climbed.

    Raises:
        UsageError: an invalid label.
        IncomparableError, StoreError, SceneError, TrialError, PrerequisiteError: as `run`.
    """
    from nw_eval.api.baseline_comparison import BaselineComparison
    from nw_eval.api.plans import rechecked
    from nw_eval.engine import session
    from nw_eval.engine.order import unforeseen_seed
    from nw_gate.baseline.combine import unjudged
    from nw_gate.results.labels import ci_labels, usable

    how = replace(
        how,
        labels=usable({**ci_labels(os.environ), **(how.labels or {})}),
        # Scores are judged once, of all trials: only success alone may settle a run early.
        all_rounds=how.all_rounds or bool(plan.suite.gate.scores),
    )
    if plan.is_baseline and plan.drawn is None:
        # The starts that run again are drawn now: no file says which they will be.
        whole = how.all_rounds or plan.shard is not None
        plan = rechecked(plan, unforeseen_seed(), all_rounds=whole)
    comparison = None
    for text in _preflight_messages(plan):
        how.told.message(text)
    if plan.against is not None:
        comparison = BaselineComparison(plan, plan.against, how)
    elif (plan.shard is None or plan.shard.count == 1) and plan.request.baseline != "none":
        name = plan.suite.name if plan.request.suite is None else str(plan.request.suite)
        policy = plan.bundle.name if plan.request.policy is None else plan.request.policy
        if why := unjudged(plan.suite.gate, name, policy):
            how.told.message(why)
    folder = session.carry_out(
        plan, how, out=out, resume=resume, comparison=comparison, meanwhile=prepare_pages
    )
    if plan.suite.gate.limits and ladders:
        from nw_eval.api.limit_climbs import climb_limits

        climb_limits(plan, folder, how)
    return folder


def _preflight_messages(plan: Plan) -> Iterator[str]:
    """Yield what is said before a run begins."""
    from nw_eval.engine.plan import obstacles_of
    from nw_scenes.robots import find_robot

    if plan.shard is not None and plan.shard.count > 1:
        yield _part(plan, plan.shard)
    for note in find_robot(plan.suite.robot).notes:
        yield f"robot {plan.suite.robot.partition('@')[0]}: {note}"
    if perturbed := dict(plan.suite.perturb.cells[0]):
        from nw_sim.rollout.perturbed import unfelt  # Which imports the physics.

        for axis in unfelt(plan.bundle.card, perturbed, plan.suite.task):
            yield f"perturb.{axis} changes nothing for {plan.bundle.card.name}: no sense for it"
    for scene, finding in _trail_faults(plan):
        yield f"scene {scene}: {finding.message}; {finding.fix}"
    yield from _beyond_legs(plan)
    for reason in obstacles_of(plan):
        yield f"this run cannot PASS: {reason}"


def _trail_faults(plan: Plan) -> Iterator[tuple[str, SceneFinding]]:
    """Yield what `scenes check` says of the courses of a plan's own scenes, which still run.

    The built-in ones are right.
    """
    from nw_sim.catalogue import is_built_in

    for found_scene in plan.found:
        if not is_built_in(found_scene.reference):
            # It imports rays and their compiler, which a run of built-in scenes does without.
            from nw_sim.survey.course import course_findings

            for finding in course_findings(found_scene.scene, plan.suite.robot):
                yield found_scene.scene.name, finding


def _beyond_legs(plan: Plan) -> Iterator[str]:
    """Yield a line on what scenes of a plan ask that its robot's legs could never do, if anything.

    Built-in scenes are made for the built-in robots.
    """
    from nw_scenes.robots import BUILT_IN, get_robot
    from nw_sim.catalogue import is_built_in

    is_ours = plan.suite.robot in BUILT_IN
    places = [each for each in plan.found if not (is_ours and is_built_in(each.reference))]
    if not places:
        return
    from nw_sim.survey.legs import fit_of, legs_of

    legs = legs_of(get_robot(plan.suite.robot))
    fits = {found_scene.scene.name: fit_of(found_scene.scene, legs) for found_scene in places}
    asked = [f"{name} ({', '.join(fit.beyond)})" for name, fit in fits.items() if fit.beyond]
    if asked:
        some = ", ".join(asked[:3]) + (f" and {len(asked) - 3} more" if len(asked) > 3 else "")
        yield (
            f"more than the legs of {legs.robot} could do, {legs.length:.2f} m long: {some}; "
            "`nw-eval scenes list --robot` says which scenes suit"
        )


def _part(plan: Plan, shard: ShardInfo) -> str:
    """Return which part of a run is run here."""
    trials = plural(len(plan.trials), "trial")
    return f"{shard}: {trials}; `nw-eval merge` judges the whole run"


def judged(folder: RunFolder, *, how: Callable[[Path], RunReport] | None = None) -> RunReport:
    """Judge a run that has just ended; arguments as of `report_here`.

    Raises:
        StoreError: its folder was removed, or the report cannot be written.
    """
    from nw_eval.engine.rounds import Presence

    try:
        with TracebackIn(folder.path):
            outcome = report_here(folder.path, how=how)
    except UsageError:  # As if nothing had run: it is not a run folder any more.
        Presence(folder.journal).check()
        raise
    # Writing a report into a folder that was removed makes it anew.
    Presence(folder.journal).check()
    return outcome


UNNAMED = "unnamed"
"""What rows have in place of a digest where it is unknown which policy it was."""


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
    **changes: Any,
) -> RunReport:
    """Roll a policy out through a suite, write the evidence, and judge it.

    A policy by name runs as `run` does it. An object runs in this process, one trial after another,
    each begun with `reset(seed)`; nothing confines it, and nothing ends it if it hangs. Its digest
    is what `version` says, which cannot be verified, and its logs cannot be replayed.

    Args:
        policy: a bundle's name, folder or card; or an object with `act(observation)`, or a function
            in place of that.
        suite: a suite file or the name of a shipped one.
        card: what an object sees and what its actions mean: at least `control`, and `observations`
            for one that looks. A mapping gets robot and name from the suite and the object.
        version: which policy an object is, such as its step or the hash of its weights.
        out: the run's folder (default: a new one in `reports/`).
        changes: fields of `Request` by name, such as trials, scenes, record and seed, `labels` and
            `listener`; for a policy by name whatever `run` takes. The suite's own baseline counts
            for the suite's own policy by name; `baseline` names one for any other.

    Raises:
        UsageError: an object has no card, or a policy by name has one; no such suite.
        SuiteError: what is wrong with the suite and its scenes.
        PolicyError: the card or the checkpoint cannot be used.
        StoreError: results cannot be written; those that were written stay.
    """
    from nw_eval.api.plans import plan_of
    from nw_eval.suite import draft_suite

    out = None if out is None else Path(out)
    if isinstance(policy, str | Path):
        if card is not None or version != UNNAMED:
            raise UsageError(
                f"policy {str(policy)!r} has a card and a digest of its own",
                fix="leave `card` and `version` out, or pass the policy as an object",
            )
        return run(suite, out=out, policy=str(policy), **changes)
    if card is None:
        raise UsageError(
            f"a policy that is an object ({type(policy).__name__}) needs a card",
            fix="pass `card={'control': ..., 'observations': ...}`",
        )
    bundle = _bundle(policy, suite, card, version)
    how = replace(How.taken_from(changes, "labels", "listener"), in_process=True)
    request = Request.of(suite, policy=bundle.name, **changes)
    check_limits(request, "a policy that is an object")
    return judged(roll_out(plan_of(request, draft_suite(suite), bundle=bundle), how, out=out))


def _bundle(
    policy: object, suite: str | Path, card: Card | Mapping[str, Any], version: str
) -> Bundle:
    """Return an object with its card, completed from the suite and the object."""
    from nw_eval.suite import load_suite
    from nw_policies import instance_bundle
    from nw_policies.cards.load import card_of
    from nw_scenes.robots import find_robot

    if isinstance(card, Mapping):
        own = load_suite(suite)
        origin: Any = policy if hasattr(policy, "__name__") else type(policy)
        module, name = (
            re.sub(r"[^\w.]", "_", origin.__module__),
            re.sub(r"\W", "_", origin.__name__),
        )
        card = card_of(
            {
                "nw-policy": 1,
                "name": re.sub(r"[^a-z0-9.]+", "-", name.lower()).strip("-.")[:64] or "policy",
                "robot": card.get("robot") or find_robot(own.robot, own.base).spec.name,
                "adapter": f"python:{module}:{name}",
                **card,
            }
        )
    return instance_bundle(policy, card, digest=version)
