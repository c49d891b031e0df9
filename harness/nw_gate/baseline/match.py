"""What a baseline is to a run: whether it fits, on what basis, and which starts come when.

What does not match is named field by field, with both values and what renews the baseline. The
order of the starts is the same for who runs and who judges. What the baseline scored is there
as rows (`known_rows`), and beside trials of its own policy that run again (`recheck`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from shlex import quote
from typing import Any, Literal

from nw_base.errors import IncomparableError, StoreError
from nw_base.plural import plural
from nw_base.trials import DrawnStart, cells_of, digest_of_trials, expand
from nw_base.words import Tier
from nw_gate.results.baseline import (
    BaselineResults,
    Panel,
    Start,
    Stratum,
    key_of,
    machine_of,
    trajectory,
)
from nw_gate.results.provenance import PolicyInfo, RunInfo
from nw_gate.results.row import Row, from_dict
from nw_gate.settings import Gate, tier_of
from nw_gate.stats.baseline.trials import order_of_starts, order_of_trials
from nw_gate.verdict import Basis, Claim, Recheck

_NAMED = 3  # scenes or trials, and values of each, that a sentence names before it says "and more"


def check_match(run: RunInfo, baseline: BaselineResults) -> None:
    """Refuse a baseline that does not hold for a run.

    A run on a fresh seed set differs in its seed, and may; one that was asked for some scenes only
    may lack the others.

    Raises:
        IncomparableError: naming every field that differs.
    """
    faults = [
        *_suite_faults(run, baseline),
        *_scene_faults(run, baseline),
        *_simulator_faults(run, baseline),
        *_score_faults(run, baseline),
    ]
    if faults:
        raise IncomparableError(
            f"baseline {baseline.manifest.name} is not compatible with run {run.id}: "
            f"{'; '.join(faults)}",
            fix=f"renew the baseline with `{renewing(run, baseline)}`",
        )


def renewing(run: RunInfo, baseline: BaselineResults, *options: str) -> str:
    """Return the command that makes a baseline anew for the suite of a run.

    Args:
        run: the run.
        baseline: the baseline.
        options: what the command is to say besides, in place of --renew.
    """
    suite, policy = baseline.manifest.suite, baseline.manifest.policy.typed
    if run.request is not None:
        suite = str(run.request.suite or suite)
        policy = run.request.baseline_policy or policy
    return saving(baseline, suite, policy, *options)


def saving(baseline: BaselineResults, suite: str, policy: str, *options: str) -> str:
    """Return the command that renews a suite's baseline, from a policy as it can be typed."""
    own = baseline.manifest.name
    name = [] if own == baseline.manifest.policy.name else ["--name", own]
    words = ["nw-eval", "baseline", "save", suite, "--policy", policy, *(options or ["--renew"])]
    return " ".join(quote(word) for word in [*words, *name])


def _suite_faults(run: RunInfo, baseline: BaselineResults) -> Iterable[str]:
    ours, theirs = key_of(run), baseline.manifest.key
    if ours.seed != theirs.seed and run.panel == "pinned" and not baseline.manifest.held_out:
        yield f"its seed is {ours.seed}, the baseline's {theirs.seed}"
    if ours.protocol != theirs.protocol:
        yield f"its protocol is {ours.protocol}, the baseline's {theirs.protocol}"
    if ours.seed == theirs.seed and run.panel == "fresh":
        yield f"its seed {ours.seed} is the baseline's, so its initial states are not fresh"
    if ours.suite_digest == theirs.suite_digest:
        return
    # Whatever differs besides seed and protocol is in the digest alone.
    alike = {**run.suite, "seed": theirs.seed, "protocol": theirs.protocol}
    if digest_of_trials(alike) != theirs.suite_digest:
        digests = f"{ours.suite_digest[:8]}, the baseline's {theirs.suite_digest[:8]}"
        yield f"its suite digest is {digests}: {_what_else(run, baseline)}"


def _what_else(run: RunInfo, baseline: BaselineResults) -> str:
    """Return which settings differ, as far as a baseline knows its own."""
    ours = sorted(cells_of(run.suite["perturb"]))
    theirs = sorted({cell for _, cell in baseline.panels[0].by_stratum})
    if ours == theirs:
        return "robot, task, episode, pictures or version of a plug-in differ"
    return f"perturb is {_cells(ours)}, the baseline's {_cells(theirs)}"


def _cells(cells: list[tuple[tuple[str, float], ...]]) -> str:
    return ", ".join(
        " ".join(f"{axis} {value:g}" for axis, value in cell) or "nothing" for cell in cells
    )


def _scene_faults(run: RunInfo, baseline: BaselineResults) -> Iterable[str]:
    ours, theirs = key_of(run).scenes, baseline.manifest.key.scenes
    if unknown := sorted(set(ours) - set(theirs)):
        yield f"{_scenes(unknown)} not in the baseline"
    restricted = run.request is not None and run.request.scenes is not None
    if (absent := sorted(set(theirs) - set(ours))) and not restricted:
        yield f"{_scenes(absent)} in the baseline and not in the run"
    changed = sorted(name for name in set(ours) & set(theirs) if ours[name] != theirs[name])
    if changed:
        first = changed[0]
        digests = f"{ours[first][:8]} now, {theirs[first][:8]} in the baseline"
        more = f", and {len(changed) - 1} more" if len(changed) > 1 else ""
        yield f"scene {first} has changed ({digests}){more}"


def _scenes(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    plural = "s" if len(names) > 1 else ""
    return f"scene{plural} {', '.join(names[:_NAMED])}{more} {'are' if plural else 'is'}"


def _simulator_faults(run: RunInfo, baseline: BaselineResults) -> Iterable[str]:
    ours, theirs = key_of(run).simulator, baseline.manifest.key.simulator
    for name in sorted({*ours, *theirs}):
        if ours.get(name) != theirs.get(name):
            there = theirs.get(name, "none")
            yield f"its {name} is {ours.get(name, 'none')}, the baseline's {there}"


def _score_faults(run: RunInfo, baseline: BaselineResults) -> Iterable[str]:
    ours, theirs = key_of(run).measured, baseline.manifest.key.measured
    for key in sorted(ours):
        name = key.partition(".")[2]
        if name in baseline.manifest.scores and ours[key] != theirs.get(key):
            there = theirs.get(key, "unknown")
            yield f"its {key} is {_short(ours[key])}, the baseline's {_short(there)}"


def _short(identity: str) -> str:
    """Return `package version` with the first digits of the code's digest."""
    return re.sub(r"\b([0-9a-f]{8})[0-9a-f]{56}$", r"\1", identity)


_NOTHING = sha256(b"").hexdigest()


def basis_of(run: RunInfo, baseline: BaselineResults, checked: str | None) -> tuple[Basis, Panel]:
    """Return what the baseline is to the run's trials, and its results that are compared.

    Args:
        run: on the baseline's suite and simulator (`check_match`).
        baseline: to compare with.
        checked: what trials of the baseline have shown on this machine type.

    Raises:
        IncomparableError: the baseline has no results from this machine type, and none
            was checked.
    """
    panel = baseline.panel_of(machine_of(run))
    if is_baseline(run.policy, baseline):
        return "same", panel or baseline.panels[0]
    if panel is None and checked not in {"bits", "control"}:
        raise IncomparableError(
            f"baseline {baseline.manifest.name} has no results from this machine type "
            f"({_unlike(run, baseline)}), and no trial of the baseline has been run on it",
            fix=f"`nw-eval run --baseline {baseline.manifest.name}` runs some first, or add this "
            "machine's results "
            f"with `{renewing(run, baseline)}`",
        )
    if panel is None and checked == "control":
        return "control", baseline.panels[0]
    if met_others(run, baseline):
        return "fresh", panel or baseline.panels[0]
    return "panel", panel or baseline.panels[0]


def met_others(run: RunInfo, baseline: BaselineResults) -> bool:
    """Return whether the run's trials are of other starts than the baseline's."""
    return run.panel == "fresh" or key_of(run).seed != baseline.manifest.key.seed


def claim_of(
    run: RunInfo, baseline: BaselineResults, basis: Basis, rounds: int, gate: Gate
) -> Claim:
    """Return of which starts a comparison speaks: of fresh ones, unless the suite says otherwise.

    Of the seed set itself it may only where the order was drawn for this candidate from all of it:
    the first starts of a seed set are as random as any among all starts, but not among those of the
    seed set.

    Raises:
        IncomparableError: the baseline has fewer starts than were drawn, or `gate.claim` is panel
            where none were.
    """
    has, is_drawn = baseline.manifest.starts, basis == "panel" and run.drawn_from is not None
    needs = max(rounds if is_drawn else 0, run.drawn_from or 0)
    if basis != "same" and has < needs:
        raise IncomparableError(
            f"baseline {baseline.manifest.name} has {has} initial states in each scene; the run "
            f"needs {needs}",
            fix=f"save them with `{renewing(run, baseline, '--trials', str(needs))}`, or run fewer "
            "--trials",
        )
    if basis in {"panel", "fresh"} and gate.claim == "fresh":
        check_starts(baseline, gate, run)
    if gate.claim == "fresh" or basis == "same":
        return "fresh"
    if is_drawn and run.drawn_from == has:
        return "panel"
    raise IncomparableError(
        f"gate.claim is panel, but the candidate's initial states were not drawn for it from "
        f"all {has} of baseline {baseline.manifest.name} on a machine that it knows",
        fix="write `claim: fresh`",
    )


def check_starts(baseline: BaselineResults, gate: Gate, run: RunInfo) -> None:
    """Refuse a baseline whose sample is too small for a claim about new initial states.

    Raises:
        IncomparableError: naming the command that saves more.
    """
    has, least = baseline.manifest.starts, gate.least_starts
    if has < least:
        raise IncomparableError(
            f"baseline {baseline.manifest.name} has {plural(has, 'initial state')} in each "
            f"scene; a claim about new initial states needs {least}, or "
            "its errors are larger than they say",
            fix=f"save them with `{renewing(run, baseline, '--trials', str(least))}`",
        )


def is_baseline(policy: PolicyInfo, baseline: BaselineResults) -> bool:
    """Return whether a policy is the baseline itself, as far as its digests can say."""
    theirs = baseline.manifest.policy
    # An object in a process has whatever name its caller gives it; some servers give no digest.
    anonymous = policy.adapter == "remote" and policy.checkpoint_digest == _NOTHING
    verified = re.fullmatch("[0-9a-f]{64}", policy.checkpoint_digest) and not anonymous
    ours = (policy.checkpoint_digest, policy.card_digest)
    return bool(verified) and ours == (theirs.checkpoint_digest, theirs.card_digest)


def _unlike(run: RunInfo, baseline: BaselineResults) -> str:
    """Return in what this class of machine differs from the baseline's nearest one."""
    ours = machine_of(run)
    differing = [
        [
            f"{name} {ours.get(name, 'none')}, the baseline's {panel.machine.get(name, 'none')}"
            for name in sorted({*ours, *panel.machine})
            if ours.get(name) != panel.machine.get(name)
        ]
        for panel in baseline.panels
    ]
    return ", ".join(min(differing, key=len))


_FRESH = 1000
"""Starts in each scene of which fresh ones are drawn, so that a run with more trials begins with
those of one with fewer. Which of them a trial has does not matter: no trial has used any."""


def drawn_order(run: RunInfo, strata: Sequence[Stratum], rounds: int) -> list[DrawnStart]:
    """Return all trials of a run in the order in which they are judged against a baseline.

    Args:
        run: what says how its order was drawn.
        strata: scenes, and what is changed there, of the run.
        rounds: trials of each on average.

    Raises:
        IncomparableError: it was drawn in another way, by an older nw-eval.
    """
    # Of fresh starts no baseline drew any, and yet the first ones of each scene were judged.
    if run.run < 2 and (run.drawn_from is not None or run.baseline is not None):
        raise IncomparableError(
            f"run {run.id} was drawn round by round by an older nw-eval, and this one judges trial "
            "by trial",
            fix="run it again",
        )
    order = {"candidate": run.drawn_by, "suite_digest": run.suite_digest}
    if (run.is_recheck or run.goes_by_rounds) and run.drawn_from is not None:
        return draw_rounds(strata, run.drawn_from, rounds, **order)
    if run.drawn_from is None and run.panel == "fresh" and run.baseline is not None:
        return draw_fresh(strata, rounds, **order)
    starts = rounds if run.drawn_from is None else run.drawn_from
    return draw_trials(strata, starts, rounds, **order)


def draw_trials(
    strata: Sequence[Stratum], starts: int, rounds: int, *, candidate: str, suite_digest: str
) -> list[DrawnStart]:
    """Return the first `rounds` x S of all pairs of a stratum and a start, in random order.

    Args:
        strata: scenes, and what is changed there, shape (S,).
        starts: M, of each.
        rounds: trials of each on average.
        candidate: who is judged, by its `key`: the order is one for each network with its card.
        suite_digest: of the suite.
    """
    order = order_of_trials(
        [_label(stratum) for stratum in strata],
        starts,
        candidate_digest=candidate,
        suite_digest=suite_digest,
    )
    return [(*strata[which], start) for which, start in order[: rounds * len(strata)]]


def draw_fresh(
    strata: Sequence[Stratum], rounds: int, *, candidate: str, suite_digest: str
) -> list[DrawnStart]:
    """Return as `draw_trials` does trials 0, 1, ... of each stratum: unused starts."""
    met = dict.fromkeys(strata, 0)
    drawn: list[DrawnStart] = []
    most = max(_FRESH, rounds)
    for scene, cell, _ in draw_trials(
        strata, most, rounds, candidate=candidate, suite_digest=suite_digest
    ):
        drawn.append((scene, cell, met[scene, cell]))
        met[scene, cell] += 1
    return drawn


def draw_rounds(
    strata: Sequence[Stratum], starts: int, rounds: int, *, candidate: str, suite_digest: str
) -> list[DrawnStart]:
    """Return trials round by round: one start of every stratum, drawn from all of its starts.

    That is how starts of the baseline's own policy run again: some of each scene. Arguments are
    those of `draw_trials`.
    """
    ordered = sorted(strata)
    columns = [
        order_of_starts(
            starts, candidate_digest=candidate, suite_digest=suite_digest, scene=_label(stratum)
        )[:rounds]
        for stratum in ordered
    ]
    return [
        (*stratum, start)
        for drawn in zip(*columns, strict=True)
        for stratum, start in zip(ordered, drawn, strict=True)
    ]


def _label(stratum: Stratum) -> str:
    scene, cell = stratum
    return scene + "".join(f" {axis}={value!r}" for axis, value in cell)


def fresh_seed(
    candidate: PolicyInfo,
    settings: Mapping[str, Any],
    *,
    purpose: Literal["fresh", "held-out"] = "fresh",
) -> int:
    """Return the seed of the starts that only this candidate meets in a suite, 0 to 2^63 - 1.

    It is the first 63 bits of sha256("<purpose>/<checkpoint digest>/<card digest>/<suite digest>"),
    the digest being that of the suite with seed 0. So it cannot be chosen: a checkpoint has one
    fresh seed set in a suite, whatever seed set is pinned there.

    Args:
        candidate: who is judged.
        settings: of the suite that it is to meet, with any seed.
        purpose: fresh for its own run, held-out for its baseline: the two have no start in common.
    """
    unseeded = digest_of_trials({**settings, "seed": 0})
    text = f"{purpose}/{candidate.key}/{unseeded}"
    return int.from_bytes(sha256(text.encode()).digest()[:8], "big") >> 1


FROM_START = (
    *("success", "completed", "outcome", "end_reason"),
    *("waypoints_reached", "waypoints_total"),
)
"""Columns of a row that a baseline has of each start."""

_NO_TIMES = dict.fromkeys(("physics_s", "render_s", "policy_s", "log_s", "wall_s"), 0.0)


@dataclass(frozen=True, kw_only=True)
class _Place:
    """A scene, as its trials' identities need it."""

    name: str
    task: str
    digest: str


class _Asked:
    """The suite of a run, as far as its trials need it."""

    def __init__(self, run: RunInfo, trials: int) -> None:
        said = run.suite
        self.name, self.digest, self.seed = str(said["name"]), run.suite_digest, int(said["seed"])
        self.trials, self.gate, self.perturb = trials, self, self
        self.cells = cells_of(said["perturb"])
        self._tiers: Mapping[str, Tier] = said["gate"]["tiers"]

    def tier(self, scene: str) -> Tier:
        """Return how much a scene counts."""
        return tier_of(scene, self._tiers)


def known_rows(run: RunInfo, baseline: BaselineResults) -> tuple[Row, ...]:
    """Return a baseline's results as rows, taken over (`Row.cached`): they cost this run no time.

    They are for judging only. What a baseline does not hold of a trial, its steps and digests, they
    do not hold either.

    Args:
        run: of the baseline's own policy.
        baseline: which fits the run: the results of its class of machine, or else the first.
    """
    panel = baseline.panel_of(machine_of(run)) or baseline.panels[0]
    starts = {(*start.stratum, start.seed_index): start for start in panel.starts}
    suite = _Asked(run, baseline.manifest.starts)
    scenes = [_Place(name=name, task=s.task, digest=s.digest) for name, s in run.scenes.items()]
    rows: list[Row] = []
    for trial in expand(suite, scenes):
        start = starts[trial.scene, trial.perturbation, trial.index]
        known = {
            "trial_id": trial.id,
            "suite": trial.suite,
            "scene": trial.scene,
            "task": trial.task,
            "robot": run.suite["robot"],
            "tier": trial.tier,
            "seed_index": trial.index,
            "seed": trial.seed,
            "policy": run.policy.name,
            "arm": "baseline",
            "perturbation": trial.perturbation,
            "status": "ok",
            "steps": 0,
            "sim_s": 0.0,
            "checkpoint_digest": run.policy.checkpoint_digest,
            "scene_digest": trial.scene_digest,
            "cached": True,
            **{name: getattr(start, name) for name in FROM_START},
            "task_kind": start.task_kind,
            "scores": start.scores,
            **_NO_TIMES,
        }
        rows.append(from_dict(known))
    return tuple(rows)


def recheck(rows: Sequence[Row], run: RunInfo, baseline: BaselineResults) -> Recheck:
    """Compare trials of the baseline's own policy with what the baseline says of these starts.

    On a class of machine that the baseline has been run on, values and bits must be equal. On
    another one bits may be others. Then nothing is reused, and only a trial that has the
    baseline's bits and another result speaks against the baseline.

    Args:
        rows: of the run, whose policy is the baseline's by its digests, on the pinned seed set.
        run: what they are of.
        baseline: to compare with.

    Raises:
        StoreError: a row is of no initial state of the baseline.
    """
    seen = baseline.panel_of(machine_of(run))
    done = [row for row in rows if row.status == "ok"]
    # The results that `known_rows` uses.
    panel = seen or baseline.panels[0]
    differing = differences(done, panel)
    ran = {(row.scene, row.perturbation) for row in done if not row.cached}
    strata = {(row.scene, row.perturbation) for row in rows}
    planned = sum(run.planned.values())
    wrong = contradictions(done, baseline, panel)
    if differing and seen is not None:
        count = f"{len(differing)} of {plural(len(done), 'trial')}"
        more = len(differing) - _NAMED
        name = baseline.manifest.name
        rest = f"and {plural(more, 'more trial')}; `nw-eval baseline verify` names all"
        wrong = (
            f"the baseline {name} is not what its own policy does: {count} differ",
            *differing[:_NAMED],
            *([rest] if more > 0 else []),
        )
    return Recheck(
        compared=len(done),
        ran=sum(not row.cached for row in done),
        equal=not differing,
        differing=wrong,
        taken_over=run.is_recheck
        and run.stop is not None
        and not differing
        and 0 < planned == len(done)
        and ran == strata,
    )


def contradictions(rows: Iterable[Row], baseline: BaselineResults, panel: Panel) -> tuple[str, ...]:
    """Return sentences where trials have the bits of a baseline, and another result; or nothing.

    The same states and actions are the same trial: its result is no matter of the machine.

    Args:
        rows: with results, of the baseline's own policy.
        baseline: to compare with.
        panel: of it.

    Raises:
        StoreError: a row is of no initial state of the baseline.
    """
    same = [row for row in rows if trajectory(row) == _start_of(row, panel).trajectory]
    sentences = differences(same, panel)
    if not sentences:
        return ()
    own = baseline.manifest.policy.name
    first = f"the baseline is not what its own policy {own} does: the same actions, other results"
    return (first, *sentences[:_NAMED])


def differences(rows: Iterable[Row], panel: Panel) -> tuple[str, ...]:
    """Return a sentence for each trial that differs from a baseline, by scene and start.

    Args:
        rows: with results, of the baseline's own policy.
        panel: what the baseline says.

    Raises:
        StoreError: a row is of no initial state of the baseline.
    """
    sentences: list[tuple[Start, str]] = []
    for row in rows:
        start = _start_of(row, panel)
        if (text := difference(row, start)) is not None:
            sentences.append((start, text))
    sentences.sort(key=lambda item: (item[0].stratum, item[0].seed_index))
    return tuple(text for _, text in sentences)


def difference(row: Row, start: Start) -> str | None:
    """Return what of a trial is not as the baseline says, both values of each; None if nothing.

    Args:
        row: with a result.
        start: what the baseline says of it.
    """
    pairs = [(name, getattr(start, name), getattr(row, name)) for name in FROM_START]
    parts = [
        f"{name} {measured}, the baseline's {recorded}"
        for name, recorded, measured in pairs
        if recorded != measured
    ]
    if not parts and trajectory(row) != start.trajectory:
        parts = [f"bits {trajectory(row)}, the baseline's {start.trajectory}"]
    elif not parts:
        # Of the same states, but sums of them may end in other bits on another CPU.
        said = dict(start.scores)
        parts = [
            f"{name} {measured:g}, the baseline's {said[name]:g}"
            for name, measured in row.scores
            if name in said and not math.isclose(measured, said[name], rel_tol=1e-9, abs_tol=1e-12)
        ]
    if not parts:
        return None
    cell = "".join(f" {axis} {value:g}" for axis, value in start.perturbation)
    # The first says most: the others follow from it.
    return f"scene {start.scene}{cell} start {start.seed_index}: {', '.join(parts[:_NAMED])}"


def _start_of(row: Row, panel: Panel) -> Start:
    starts = panel.by_stratum.get((row.scene, row.perturbation), ())
    if not 0 <= row.seed_index < len(starts):
        raise StoreError(
            f"trial {row.trial_id} has no initial state of the baseline, which has {len(starts)} "
            "in its scene",
            fix="judge the run against the baseline that it was started with",
        )
    return starts[row.seed_index]
