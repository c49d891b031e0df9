"""Whether a run is worse than a baseline for what its policy sees, or for what it does about it.

Two policies are taken apart, and put together crosswise: one's control with the other's perception.
Perception is what a card says of sensors of the world around (images, depth, classes, heights,
laser scanners) and of where cameras sit; control is all the rest: weights, gains, what an action
means, and what the robot feels of itself or is told.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, fields, replace
from glob import escape
from io import StringIO
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.errors import PolicyError, StoreError, UsageError
from nw_eval.api.paths import as_path
from nw_eval.engine.how import How

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from os import PathLike

    from nw_eval.engine.plan import Plan
    from nw_eval.suite import Suite
    from nw_gate.cause import Apart, Arm, Cause
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row
    from nw_policies import Bundle
    from nw_policies.cards import Card


@dataclass(frozen=True, kw_only=True)
class FoundCause:
    """What a run's drop against a baseline is due to.

    Attributes:
        run: the run's folder.
        cause: its result.
        out: folder of the four policies' runs, and of `cause.md`.
    """

    run: Path
    cause: Cause
    out: Path


def find_cause(
    run: str | PathLike[str],
    *,
    baseline: str,
    policy: str | None = None,
    checkpoint: str | PathLike[str] | None = None,
    trials: int | None = None,
    allow_code: bool = False,
    out: str | PathLike[str] | None = None,
    **how: Any,
) -> FoundCause:
    """Run old and new control with old and new perception in the trials of a run, and compare.

    Args:
        run: the run's folder; its suite, its starts and its policy.
        baseline: a baseline, whose policy is the old one; or a policy.
        policy: where the baseline's policy lies, if not where the baseline says.
        checkpoint: weights in place of those that its card names.
        trials: in each scene (default: the run's own number). More than it has are those that would
            come next.
        allow_code: whether Python code that cards name may be imported.
        out: a new folder (default: `cause` or `cause-<n>` in the run's folder).
        how: fields of `How` by name: workers, cache, listener.

    Raises:
        UsageError, StoreError, IncomparableError: as `attribute`; no trial was ended by all four.
        PolicyError: the policies cannot be taken apart, or not put together crosswise.
    """
    from nw_eval.api.attribution import baseline_bundle
    from nw_eval.api.cause import apart, write_crossed
    from nw_eval.api.continuing import continued
    from nw_eval.api.saved_run import check_whole
    from nw_eval.reporting.markdown import write_cause
    from nw_gate.cause import ARMS, write_cause_file
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.request import Request
    from nw_gate.results.run_folder import open_run_folder
    from nw_sim.rollout.confined.start import prepare

    run = as_path(run)
    checkpoint = as_path(checkpoint)
    out = as_path(out)
    means = How.of(how, "workers", "cache", "listener")
    if trials is not None and trials < 1:
        raise UsageError(f"--trials {trials} is too low", fix="give at least 1")
    source = open_run_folder(run)
    info = check_whole(read_run_info(source.run_json))
    base = continued(run, Request(allow_code=allow_code, shard=None))
    new = base.bundle
    old = baseline_bundle(baseline, info, policy=policy, checkpoint=checkpoint)
    different = apart(old, new)
    if not allow_code:
        prepare()
    folder = _folder(source.path, out)
    suite = _plain(base.suite, _rounds(info, base.suite, trials))
    bundles = {"old": old, "new": new}
    plans: dict[Arm, Plan] = {}
    for arm in ARMS:
        control, sight = (bundles[side] for side in arm)
        if _same(arm, different) == arm:
            card = control.reference
            if arm[0] != arm[1]:
                name = _name(arm)
                card = str(write_crossed(folder / name / "policy", control, sight, name=name))
            plans[arm] = _planned(base, info, suite, card, control)
    runs = {arm: _rolled(planned, folder / _name(arm), means) for arm, planned in plans.items()}
    rows = {arm: runs[_same(arm, different)] for arm in ARMS}
    cause = _caused(rows, different, old=old.name, new=new.name)
    write_cause(cause, source.id, folder / "cause.md")
    write_cause_file(cause, source.cause)
    return FoundCause(run=source.path, cause=cause, out=folder)


def _name(arm: Arm) -> str:
    return f"{arm[0]}-control-{arm[1]}-sight"


def _same(arm: Arm, apart: Apart) -> Arm:
    """Return which policy as it is an exchanged one is; itself where it is none of them."""
    control, sight = arm
    if not apart.sight:
        return control, control
    if not apart.rest and not apart.weights:
        return sight, sight
    return arm


def _caused(rows: Mapping[Arm, Sequence[Row]], apart: Apart, *, old: str, new: str) -> Cause:
    from nw_gate.cause import cause_of

    try:
        return cause_of(rows, apart, old=old, new=new)
    except ValueError as error:
        raise UsageError(str(error), fix="read the reports of the four runs") from None


def _rounds(info: RunInfo, suite: Suite, trials: int | None) -> int:
    """Return how many trials of each scene, on average, the four policies run.

    Raises:
        UsageError: the run has none, or its baseline has too few starts for as many.
    """
    rounds = trials or suite.trials
    if trials is None and info.stop is not None:
        cells = max(1, len(info.scenes) * len(suite.perturb.cells))
        rounds = ceil(info.stop.first / cells)
    if not rounds:
        raise UsageError(
            f"run {info.id} ran nothing: its policy is the baseline's",
            fix="name the run of another policy",
        )
    if info.drawn_from is not None and rounds > info.drawn_from:
        raise UsageError(
            f"--trials {rounds}: the run drew its initial states from the "
            f"{info.drawn_from} of a baseline",
            fix=f"give at most {info.drawn_from}",
        )
    return rounds


def _plain(suite: Suite, rounds: int) -> Suite:
    """Return a suite that judges nothing, with so many trials of each scene."""
    from nw_gate.settings import Gate

    changes = {"gate": Gate.model_validate({}), "record": "none", "trials": rounds}
    return suite.model_copy(update=changes)


def _planned(base: Plan, info: RunInfo, suite: Suite, card: str, bundle: Bundle) -> Plan:
    """Return the plan of one of the four: the starts of the run, in its order."""
    from nw_eval.api.plans import plan
    from nw_eval.api.saved_run import whole_plan
    from nw_eval.engine.plan import DrawnOrder

    own = {field.name: getattr(base.request, field.name) for field in fields(base.request)}
    changes = {
        **own,
        "suite": None,
        "policy": card,
        "checkpoint": bundle.checkpoint,
        "baseline": "none",
        "record": "none",
        "shard": None,
        "seed": None,  # The suite has it, also where the run's starts were its policy's own.
        "panel": None,
        "trials": None,
        "scenes": tuple(escape(found_scene.scene.name) for found_scene in base.found),
    }
    planned = plan(suite, **changes)
    if info.drawn_from is None:
        return planned
    drawn = DrawnOrder(starts=info.drawn_from, candidate=info.drawn_by)
    return replace(planned, trials=whole_plan(info, suite), drawn=drawn)


def _rolled(planned: Plan, out: Path, how: How) -> Sequence[Row]:
    from nw_eval.api.reports import judge
    from nw_eval.api.runs import roll_out

    done = roll_out(planned, how, out=out / "run", ladders=False)
    report = judge(done.path, baseline="none")
    if report.interrupted:
        raise UsageError(
            f"{out} was interrupted: the comparison needs four complete runs", fix="run it again"
        )
    return report.rows


def _folder(run: Path, out: Path | None) -> Path:
    if out is not None:
        if out.exists():
            raise UsageError(f"{out} is there already", fix="name a new folder with --out")
        return out
    number = 1
    while (path := run / ("cause" if number == 1 else f"cause-{number}")).exists():
        number += 1
    return path


SIGHT = frozenset({"splat_rgb", "depth", "semantics", "scandots", "heightmap", "lidar"})
"""Sensors of the world around."""
_LABELS = ("name", "title", "licence", "nw-policy", "checkpoint")


def apart(old: Bundle, new: Bundle) -> Apart:
    """Return in what two policies differ.

    Raises:
        PolicyError: they cannot be taken apart, or their sensors cannot be swapped.
    """
    from nw_gate.cause import Apart

    for bundle in (old, new):
        if bundle.instance is not None or bundle.card.adapter == "remote":
            raise PolicyError(
                f"{bundle.subject} has no files here: its perception cannot be separated from its "
                "control",
                fix="run `nw-eval attribute` without --cause, which finds the point of no return "
                "of each failed trial",
            )
    one, other = (set(_sight(bundle.card)) for bundle in (old, new))
    if not one or one != other:
        raise PolicyError(
            f"the camera inputs of {old.name} ({_named(one)}) and {new.name} ({_named(other)}) "
            "cannot be "
            "swapped: their observations have different names",
            fix="compare policies whose networks take the same inputs",
        )
    cards = [_values_of(bundle.card) for bundle in (old, new)]
    for network in (each for card in cards for each in card.get("networks", {}).values()):
        del network["checkpoint"]  # They are weights.
    sights = [{name: card["observations"][name] for name in sorted(one)} for card in cards]
    mounts = [card.get("cameras", {}) for card in cards]
    rests = [
        {
            **{key: value for key, value in card.items() if key not in {*_LABELS, "cameras"}},
            "observations": {n: o for n, o in card["observations"].items() if n not in one},
        }
        for card in cards
    ]
    weights = old.checkpoint_digest != new.checkpoint_digest or old.code_sha256 != new.code_sha256
    return Apart(
        sight=sights[0] != sights[1] or mounts[0] != mounts[1],
        rest=rests[0] != rests[1],
        weights=weights,
    )


def write_crossed(folder: Path, control: Bundle, sight: Bundle, *, name: str) -> Path:
    """Write the card of one policy with the perception of another one; return its file.

    Its own weights stay where they are; those of networks that feed them, and Python code, are
    copied beside the card.

    Raises:
        StoreError: it cannot be written.
    """
    from nw_policies.cards.load import CARD_FILE

    card, other = _values_of(control.card), _values_of(sight.card)
    seen = _sight(control.card)
    card["observations"] = {
        key: other["observations"][key] if key in seen else value
        for key, value in card["observations"].items()
    }
    card |= {"name": name, "title": f"control of {control.name}, perception of {sight.name}"}
    card.pop("cameras", None)
    if "cameras" in other:
        card["cameras"] = other["cameras"]
    try:
        if control.code_sha256:
            shutil.copytree(control.folder, folder)
        else:
            folder.mkdir(parents=True)
        for network, weights in control.networks.items():
            own = folder / f"{network}{weights.path.suffix}"
            shutil.copyfile(weights.path, own)
            card["networks"][network]["checkpoint"] = {"file": own.name, "sha256": weights.sha256}
        path = folder / CARD_FILE
        path.write_text(_yaml(card), encoding="utf-8")
    except OSError as error:
        raise StoreError(f"cannot write {folder}: {error.strerror or error}") from error
    return path


def _sight(card: Card) -> list[str]:
    return [name for name, each in card.observations.items() if each.sensor in SIGHT]


def _values_of(card: Card) -> dict[str, Any]:
    values = card.model_dump(mode="json", by_alias=True, exclude_unset=True)
    for name, each in card.observations.items():
        values["observations"][name]["rate"] = each.rate  # Whatever the other one's default is.
    return values


def _named(names: set[str]) -> str:
    return ", ".join(sorted(names)) or "none"


def _yaml(card: dict[str, Any]) -> str:
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    stream = StringIO()
    yaml.dump(card, stream)
    return stream.getvalue()
