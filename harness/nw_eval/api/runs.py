"""Running a policy through a suite: one by name, or an object that a training loop has at hand."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, get_args

from nw_base.errors import UsageError, nearest
from nw_base.files.traceback_file import TracebackIn
from nw_base.plural import plural
from nw_base.words import Engine
from nw_eval.api.plans import plan
from nw_eval.api.reports import RunReport, prepare_pages, report_here
from nw_gate.results.request import Request
from nw_sim.rollout.confined.start import prepare

if TYPE_CHECKING:
    from collections.abc import Iterator

    from nw_eval.engine.listener import Listener
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
    workers: int | None = None,
    out: Path | None = None,
    resume: Path | None = None,
    in_process: bool = False,
    cache: bool = True,
    all_rounds: bool = False,
    engine: Engine = "local",
    address: str | None = None,
    labels: Mapping[str, str] | None = None,
    listener: Listener | None = None,
    **changes: Any,
) -> RunReport:
    """Roll a checkpoint out through a suite, write the evidence, and judge it.

    `run("hurdles", policy="stand")` is `run(Request(suite="hurdles", policy="stand"))`.

    Args:
        request: what to run, or only its suite: a file or the name of a shipped one; None only
            with `resume`.
        workers: processes; one for each core if None.
        out: the run's folder; a new one in `reports/` if None.
        resume: the folder of an interrupted run, whose finished trials are kept. What the request
            does not ask for is as the run was begun, but for leave to run code.
        in_process: run trials in this very process, one after another, for a debugger or a
            notebook: nothing confines the policy, and nothing ends it if it hangs.
        cache: take over results that earlier runs have of the same trials, all but a few, which are
            run again and compared; trials in this very process always run.
        all_rounds: go on when the verdict against a baseline is settled, also where the policy is
            the baseline itself and the others would be reused.
        engine: where trials run; rows are the same, and a run that is resumed may use another.
        address: of the Ray cluster; one of this machine is started if None.
        labels: what you call the run, such as `{"training_run": "may-3", "step": "1500"}`, beside
            what CI's variables say of the job (docs/reference/run-folder.md). No result has them.
        listener: hears of progress.
        changes: fields of `Request` by name.

    Raises:
        UsageError, SuiteError, SceneError, PolicyError, PrerequisiteError: nothing was run.
        IncomparableError: the run to resume was made under something else.
        StoreError: results cannot be written; those that were written stay.
    """
    from nw_eval.api.continuing import continued
    from nw_eval.engine.machine import check_workers

    check_workers(workers)
    if resume is not None and out is not None:
        raise UsageError("--out and --resume exclude each other", fix="drop --out")
    request = Request.of(request, **changes)
    cluster = _cluster(engine, address)
    if in_process:
        _check_in_process(request, workers, cluster)
    elif cluster is None and not request.allow_code:
        prepare()  # It takes as long as planning does.
    return judged(
        roll_out(
            plan(request) if resume is None else continued(resume, request),
            workers=workers,
            out=out,
            resume=resume,
            in_process=in_process,
            cache=cache,
            all_rounds=all_rounds,
            cluster=cluster,
            labels=labels,
            listener=listener,
        )
    )


def roll_out(
    plan: Plan,
    *,
    workers: int | None,
    out: Path | None,
    resume: Path | None = None,
    in_process: bool = False,
    listener: Listener | None,
    cache: bool = True,
    all_rounds: bool = False,
    cluster: str | None = None,
    labels: Mapping[str, str] | None = None,
) -> RunFolder:
    """Run what is planned: against a baseline, trial by trial, until bar and baseline are settled.

    A part of a run has all its trials: whether some are enough shows in the whole alone. Of the
    baseline's own policy some starts of each scene run, and the others are taken from the baseline
    if these are as it says.

    Args:
        plan: what is to be run.
        workers: as for `run`, and so are the others.
        out: the run's folder.
        resume: the folder of an interrupted run.
        in_process: whether trials run in this very process.
        listener: hears of progress.
        cache: whether results of earlier runs are reused.
        all_rounds: whether to go on when bar and baseline are settled.
        cluster: the address of a Ray cluster; None = this machine.
        labels: of the run, beside those of CI's variables, before which they go.

    Raises:
        UsageError: a label is none.
        IncomparableError, StoreError, SceneError, TrialError, PrerequisiteError: as `run`.
    """
    from nw_eval.api.contest import Contest
    from nw_eval.api.plans import rechecked
    from nw_eval.engine import session
    from nw_eval.engine.listener import NullListener
    from nw_eval.engine.order import unforeseen_seed
    from nw_gate.baseline.combine import unjudged
    from nw_gate.results.labels import ci_labels, usable
    from nw_gate.results.provenance import read_run_info

    named = usable({**ci_labels(os.environ), **(labels or {})})
    told, command = listener or NullListener(), tuple(sys.argv)
    # Scores are judged once, of all trials: only success alone may settle a run early.
    all_rounds = all_rounds or bool(plan.suite.gate.scores)
    if plan.is_baseline and plan.drawn is None:
        # The starts that run again are drawn now: no file says which they will be.
        whole = all_rounds or plan.shard is not None
        plan = rechecked(plan, unforeseen_seed(), all_rounds=whole)
    contest = None
    for words in _ahead(plan):
        told.message(words)
    if plan.against is not None:
        contest = Contest(
            plan,
            plan.against,
            workers=workers,
            cluster=cluster,
            command=command,
            listener=told,
            cache=cache,
            all_rounds=all_rounds,
        )
    elif (plan.shard is None or plan.shard.count == 1) and plan.request.baseline != "none":
        name = plan.suite.name if plan.request.suite is None else str(plan.request.suite)
        policy = plan.bundle.name if plan.request.policy is None else plan.request.policy
        if why := unjudged(plan.suite.gate, name, policy):
            told.message(why)
    folder = session.carry_out(
        plan,
        workers=workers,
        out=out,
        resume=resume,
        command=command,
        labels=named,
        listener=told,
        in_process=in_process,
        cluster=cluster,
        prelude=None if contest is None else contest.begin,
        # What is enough shows in the order of the whole run only, of which a part has none.
        enough=None if contest is None or plan.shard else contest.next,
        cache=cache,
        meanwhile=prepare_pages,
    )
    if contest is not None:
        contest.end(read_run_info(folder.run_json))
    return folder


def _ahead(plan: Plan) -> Iterator[str]:
    """Yield what is said before a run begins."""
    from nw_eval.engine.plan import obstacles_of
    from nw_scenes.robots import find_robot
    from nw_sim.rollout.perturbed import unfelt

    if plan.shard is not None and plan.shard.count > 1:
        yield _part(plan, plan.shard)
    for note in find_robot(plan.suite.robot).notes:
        yield f"robot {plan.suite.robot.partition('@')[0]}: {note}"
    for axis in unfelt(plan.bundle.card, dict(plan.suite.perturb.cells[0])):
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
    from nw_sim.survey.course import course_findings

    for place in plan.found:
        if not is_built_in(place.reference):
            for finding in course_findings(place.scene, plan.suite.robot):
                yield place.scene.name, finding


def _beyond_legs(plan: Plan) -> Iterator[str]:
    """Yield a line on what scenes of a plan ask that its robot's legs could never do, if anything.

    Built-in scenes are made for the built-in robots.
    """
    from nw_scenes.robots import BUILT_IN, get_robot
    from nw_sim.catalogue import is_built_in
    from nw_sim.survey.legs import fit_of, legs_of

    is_ours = plan.suite.robot in BUILT_IN
    places = [each for each in plan.found if not (is_ours and is_built_in(each.reference))]
    if not places:
        return
    legs = legs_of(get_robot(plan.suite.robot))
    fits = {place.scene.name: fit_of(place.scene, legs) for place in places}
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


def _cluster(engine: Engine, address: str | None) -> str | None:
    """Return the address of the cluster that trials run on; None = none.

    Raises:
        UsageError: an address of nothing, or no such engine.
    """
    if engine not in get_args(Engine):
        raise UsageError(
            f"--engine {engine!r} is unknown", fix=nearest(str(engine), get_args(Engine))
        )
    if engine == "ray":
        return address or "local"
    if address is not None:
        raise UsageError(f"--address {address} is of no use here", fix="add --engine ray")
    return None


def _check_in_process(request: Request, workers: int | None, cluster: str | None) -> None:
    """Refuse what one process cannot do.

    Raises:
        UsageError: more workers than one, or a limit that cannot be enforced.
    """
    if cluster is not None:
        raise UsageError(
            "--in-process with --engine ray: trials run here or there", fix="drop one of them"
        )
    if workers not in {None, 1}:
        raise UsageError(
            f"--workers {workers} with --in-process: it runs one trial after another",
            fix="drop one of them",
        )
    _check_limits(request, "--in-process")


def _check_limits(request: Request, door: str) -> None:
    """Refuse limits to trials that run in this very process.

    Args:
        request: what is asked for.
        door: why they do, in words.

    Raises:
        UsageError: there is a limit that cannot be enforced.
    """
    time, memory = request.time_limit, request.memory_limit
    limits = [] if time is None else [f"--time-limit {time:g}"]
    limits += [] if memory is None else [f"--memory-limit {memory}"]
    if limits:
        raise UsageError(
            f"{' and '.join(limits)} cannot be enforced with {door}",
            fix="drop one of them",
        )


def judged(folder: RunFolder, *, how: Callable[[Path], RunReport] | None = None) -> RunReport:
    """Judge a run that has just ended; arguments as of `report_here`.

    Raises:
        StoreError: its folder was removed, or the report cannot be written.
    """
    from nw_eval.engine.rounds import Presence

    try:
        with TracebackIn(folder.path):
            outcome = report_here(folder.path, how=how)
    except UsageError:  # As if nothing had run: it is no run's folder any more.
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
    labels: Mapping[str, str] | None = None,
    listener: Listener | None = None,
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
        out: the run's folder; a new one in `reports/` if None.
        labels: what you call the run, as for `run`.
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
    from nw_eval.api.plans import plan_of
    from nw_eval.suite import draft_suite

    out = None if out is None else Path(out)
    if isinstance(policy, str | Path):
        if card is not None or version != UNNAMED:
            raise UsageError(
                f"policy {str(policy)!r} has a card and a digest of its own",
                fix="leave `card` and `version` out, or pass the policy as an object",
            )
        named = {"policy": str(policy), "labels": labels}
        return run(suite, out=out, listener=listener, **named, **changes)
    if card is None:
        raise UsageError(
            f"a policy that is an object ({type(policy).__name__}) needs a card",
            fix="pass `card={'control': ..., 'observations': ...}`",
        )
    bundle = _bundle(policy, suite, card, version)
    request = Request.of(suite, policy=bundle.name, **changes)
    _check_limits(request, "a policy that is an object")
    folder = roll_out(
        plan_of(request, draft_suite(suite), bundle=bundle),
        workers=1,
        out=out,
        labels=labels,
        listener=listener,
        in_process=True,
    )
    return judged(folder)


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
