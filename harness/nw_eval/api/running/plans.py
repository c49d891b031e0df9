"""What a run would be: suite, policy and scenes resolved and checked before anything runs."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval.api.running.against.banks import check_rounds, wanted_bank
from nw_eval.errors import UsageError, nearest
from nw_eval.request import Request

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.catalogue import FoundScene
    from nw_eval.engine.forecast import Forecast
    from nw_eval.engine.plan import Plan
    from nw_eval.policies import Bundle
    from nw_eval.results.bank import Against, Stratum
    from nw_eval.results.provenance import PolicyInfo
    from nw_eval.scenes import Scene
    from nw_eval.suite import Draft, Suite
    from nw_eval.suite.trials import DrawnStart
    from nw_eval.words import Arm


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
        raise UsageError("no suite", fix="name one, such as `nw-eval run hurdles`")
    return plan_of(request, draft_suite(request.suite), may_fail=may_fail)


def plan_of(
    request: Request,
    draft: Draft,
    *,
    card: Path | None = None,
    scenes: Sequence[str] | None = None,
    bundle: Bundle | None = None,
    against: Against | None = None,
    arm: Arm = "candidate",
    own_policy: bool | None = None,
    may_fail: bool = True,
) -> Plan:
    """Resolve what is asked of a suite, as `plan` does.

    Args:
        request: what is asked for.
        draft: the suite, as far as it could be read.
        card: where its policy lies, if that is known: a run that is resumed elsewhere still names
            its policy as it was asked for, and finds it where it was.
        scenes: globs in place of the request's.
        bundle: a policy that is loaded already, in place of the request's.
        against: a bank that is read already, in place of the request's.
        arm: whether its policy is the one that is judged.
        own_policy: whether the policy is the suite's own; None = the request says.
        may_fail: whether a policy that answers zeros with NaN is left to its trials, which count
            it as the policy's own failure; else it is a fault.

    Raises:
        IncomparableError: the bank does not hold for it.
    """
    from nw_eval.api.running.faults import (
        Faults,
        is_own_policy,
        open_policy,
        open_scenes,
        vet_policy,
    )
    from nw_eval.engine.plan import Plan
    from nw_eval.engine.prepare import check_splats
    from nw_eval.engine.provenance import policy_info
    from nw_eval.engine.shards import shard_of
    from nw_eval.suite import expand, override

    suite = None if draft.suite is None else override(draft.suite, request)
    faults = Faults(draft)
    if own_policy is None:
        own_policy = bundle is None and is_own_policy(draft, request)
    # A process of its own reads the bank, for no longer than an interrupt can wait.
    with ThreadPoolExecutor(max_workers=1) as beside:
        read = None
        if suite is not None and against is None:
            read = beside.submit(wanted_bank, request, suite, own_policy=own_policy)
        found = open_scenes(draft, faults, request.collision)
        for place in found:
            _ = place.scene.digest  # Kept; what looks at the policy is still starting.
        if bundle is None:
            bundle = open_policy(draft, faults, request, card=card, may_fail=may_fail)
        else:
            bundle = vet_policy(draft, faults, request, bundle, may_fail=may_fail)
    faults.raise_any()
    assert suite is not None, "a suite that cannot be used has faults"
    assert bundle is not None, "a policy that cannot be used has faults"
    chosen = _chosen(found, request.scenes if scenes is None else scenes, suite)
    opened = [place.scene for place in chosen]
    check_splats(bundle.card, opened)
    if read is not None:
        against = read.result()
    policy = policy_info(bundle)
    suite = _on_panel(request, suite, policy, against)
    trials, shard = shard_of(
        expand(suite, opened, _drawn(request, suite, opened, policy, against)), request.part
    )
    resolved = Plan(
        request=request.from_anywhere(),
        suite=suite,
        bundle=bundle,
        found=chosen,
        left_out=tuple(
            sorted({place.scene.name for place in found} - {place.scene.name for place in chosen})
        ),
        trials=trials,
        own_policy=own_policy,
        shard=shard,
        against=against,
        arm=arm,
    )
    return resolved if against is None else _matched(resolved, against)


def baseline_plan(plan: Plan, bundle: Bundle) -> Plan:
    """Return the plan of a bank's own policy from the starts that a candidate meets, in its order.

    Of a part of a run it is that of the whole run.

    Args:
        plan: the candidate's.
        bundle: the bank's policy.

    Raises:
        UsageError: it needs images of a scene that has no splat.
    """
    from nw_eval.engine.plan import DrawnOrder
    from nw_eval.engine.prepare import check_splats
    from nw_eval.engine.provenance import policy_info
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
    """Return the plan of a bank's own policy with trials that run, whatever the cache has of them.

    Args:
        plan: with `is_baseline`.
        seed: draws the starts of each scene that run again.
        all_rounds: whether all trials run, in the order that they have.

    Raises:
        IncomparableError: the bank has fewer starts than are to run again.
    """
    from nw_eval.api.verifying.sample import draw
    from nw_eval.engine.plan import DrawnOrder
    from nw_eval.engine.provenance import policy_info
    from nw_eval.gate.baseline.match import draw_rounds
    from nw_eval.results.provenance import candidate_in, recheck_key, rounds_key
    from nw_eval.suite import expand, override

    assert plan.against is not None, "the policy of a bank has one"
    count, against = rechecks(plan.request), plan.against
    starts = against.bank.manifest.starts
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
        again = frozenset(name for names in drawn_names for name in names)
        return replace(plan, is_baseline=False, again=again)
    suite = override(plan.suite, Request(trials=max(plan.suite.trials, count)))
    check_rounds(against, suite.trials, suite, plan.request)
    key = recheck_key(seed)
    drawn = DrawnOrder(starts=starts, candidate=key)
    order = draw_rounds(strata, starts, suite.trials, candidate=key, suite_digest=suite.digest)
    trials = expand(suite, plan.scenes, order)
    again = frozenset(trial.id for trial in trials[: count * len(strata)])
    return replace(plan, suite=suite, trials=trials, drawn=drawn, again=again)


def rechecks(request: Request) -> int:
    """Return how many starts of each scene run again of a bank's own policy."""
    return 1 if request.recheck is None else request.recheck


def _strata(suite: Suite, scenes: Sequence[Scene]) -> list[Stratum]:
    return [(scene.name, cell) for scene in scenes for cell in suite.perturb.cells]


def _on_panel(request: Request, suite: Suite, policy: PolicyInfo, against: Against | None) -> Suite:
    """Return a suite with the seed of the panel that is met, and the trials that may run."""
    from nw_eval.gate.baseline.match import fresh_seed
    from nw_eval.suite import override

    seed = fresh_seed(policy, suite) if request.panel == "fresh" else None
    rounds = suite.gate.rounds if against is not None and request.trials is None else None
    return override(suite, Request(seed=seed, trials=rounds))


def _drawn(
    request: Request,
    suite: Suite,
    scenes: Sequence[Scene],
    policy: PolicyInfo,
    against: Against | None,
) -> list[DrawnStart] | None:
    """Return the trials of a run against a bank in their order; None where there is no bank.

    Raises:
        IncomparableError: the bank has fewer starts than are drawn of each scene on average.
    """
    from nw_eval.gate.baseline.match import draw_fresh, draw_trials

    if against is None:
        return None
    strata = _strata(suite, scenes)
    order = {"candidate": policy.key, "suite_digest": suite.digest}
    if request.panel == "fresh":
        return draw_fresh(strata, suite.trials, **order)
    check_rounds(against, suite.trials, suite, request)
    return draw_trials(strata, against.bank.manifest.starts, suite.trials, **order)


def _matched(plan: Plan, against: Against) -> Plan:
    """Return a plan that its bank holds for, with whether its policy is the bank's own.

    Raises:
        IncomparableError: the bank does not hold for it, or could convict nobody.
    """
    from nw_eval.engine.provenance import run_info
    from nw_eval.gate.baseline.finding import check_level
    from nw_eval.gate.baseline.judge import setup_of
    from nw_eval.results.run_folder import RunFolder

    folder = RunFolder(path=Path(plan.suite.name))
    run = run_info(plan, folder, workers=None, in_process=False, command=())
    # Whether this class of machine has the bank's bits is found out by running something.
    known = against.info.model_copy(update={"checked": "bits"})
    setup = setup_of(run.model_copy(update={"baseline": known}), against, plan.suite.gate)
    if setup.basis != "same":
        check_level(setup.panel, setup.judged, plan.suite.gate)
    is_own = setup.basis == "same" and plan.panel == "pinned" and plan.arm == "candidate"
    return replace(plan, is_baseline=is_own)


def check(
    request: Request | Suite | str | Path | None, *, workers: int | None = None, **changes: Any
) -> Forecast:
    """Return what a run would be, without running it: scenes, trials, digests, expected minutes.

    Args:
        request: as for `plan`.
        workers: processes to reckon with; one for each core if None.
        changes: fields of `Request` by name.

    Raises:
        UsageError, SuiteError, PolicyError: as `plan`.
    """
    from nw_eval.engine.forecast import forecast

    check_workers(workers)
    return forecast(_planned(request, changes, may_fail=False), workers=workers)


def check_workers(workers: int | None) -> None:
    """Refuse a number of workers that is none.

    Raises:
        UsageError: it is less than 1.
    """
    if workers is not None and workers < 1:
        raise UsageError(f"--workers {workers}", fix="give at least 1")


def _chosen(
    found: Sequence[FoundScene], globs: Sequence[str] | None, suite: Suite
) -> tuple[FoundScene, ...]:
    """Return the scenes that match a glob; all of them if there are no globs to match."""
    from nw_eval.catalogue import is_meant

    if globs is None:
        return tuple(found)
    chosen = tuple(x for x in found if any(is_meant(x.scene.name, glob) for glob in globs))
    if not chosen:
        wanted = ", ".join(globs)
        raise UsageError(
            f"--scenes {wanted} matches no scene of suite {suite.name!r}",
            fix=nearest(wanted.replace("*", ""), [place.scene.name for place in found]),
        )
    return chosen
