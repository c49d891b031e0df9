"""Sweeping: a suite again and again, along axes of perturbation."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.errors import StoreError, UsageError
from nw_base.files.cache import made_place
from nw_eval.api.paths import as_path
from nw_eval.api.plans import plan
from nw_eval.api.renamed import keywords_were
from nw_eval.api.reports import judge
from nw_eval.api.runs import roll_out
from nw_eval.engine.how import How
from nw_gate.results.request import Request
from nw_sim.rollout.confined.start import prepare

if TYPE_CHECKING:
    from os import PathLike

    from nw_eval.engine.plan import Plan
    from nw_gate.sweep import AxisCurve
    from nw_sim.axes import SweptAxis

_MOST_FOLDERS = 1000


@dataclass(frozen=True, kw_only=True)
class SweptSuite:
    """What a sweep found.

    Attributes:
        out: folder of `sweep.md`, `sweep.png`, `sweep.parquet`, and of a run for each axis and
            policy.
        suite: its name.
        axes: for each axis the curves of all policies.
        interrupted: whether trials are missing since somebody stopped it.
    """

    out: Path
    suite: str
    axes: tuple[tuple[AxisCurve, ...], ...]
    interrupted: bool


@keywords_were(against="baseline")
def sweep(
    request: Request,
    axes: Sequence[str],
    *,
    out: str | PathLike[str] | None = None,
    baseline: str | None = None,
    confidence: float = 0.95,
    **how: Any,
) -> SweptSuite:
    """Run a suite at values of one axis after another, and find where its policy breaks off.

    What the suite itself perturbs, its bar and its baseline are left out. Trials that an earlier
    sweep had with the same values of an axis are reused from the cache.

    Args:
        request: suite, policy, trials, scenes and seed as for `run`; neither shard nor baseline.
        axes: such as `friction=0.3..1.2` (7 values), `payload=0..6:4`, `push=0,0.5,1`.
        out: a new or empty folder (default: `reports/<suite>-sweep-<number>`).
        baseline: another policy, which meets the same trials.
        confidence: of each interval alone, and of all comparisons along a curve together.
        how: fields of `How` by name: workers, cache, listener.

    Raises:
        UsageError, SuiteError, SceneError, PolicyError, PrerequisiteError: nothing was run.
        StoreError: results cannot be written.
    """
    from nw_eval.api.comparisons import check_share
    from nw_eval.reporting.sweep import write_sweep
    from nw_gate.sweep import curve_of
    from nw_sim.axes import axis_named

    out = as_path(out)
    means = How.of(how, "workers", "cache", "listener")
    check_share(confidence)
    swept = _axes(axes)
    if not request.allow_code:
        prepare()
    own = replace(request, baseline="none", record="none")
    rivals = [own] if baseline is None else [own, replace(own, policy=baseline, checkpoint=None)]
    bases = [plan(each) for each in rivals]
    labels = _labels([base.bundle.name for base in bases])
    plans = [
        (axis.name, number + 1, _along(axis, bases[number], rival))
        for axis in swept
        for number, rival in enumerate(rivals)
    ]
    suite, folder = bases[0].suite.name, result_folder(out, f"{bases[0].suite.name}-sweep")
    by_axis: dict[str, list[AxisCurve]] = {}
    interrupted = False
    for name, number, planned in plans:
        done = roll_out(planned, means, out=folder / name / f"{number}", ladders=False)
        run = judge(done.path, baseline="none")
        if run.rows:
            curve = curve_of(
                axis_named(name), labels[number - 1], run.rows, confidence, run.info.scores
            )
            by_axis.setdefault(name, []).append(curve)
        interrupted = run.interrupted
        if interrupted:
            break
    curves = tuple(tuple(of_axis) for of_axis in by_axis.values())
    if curves:
        write_sweep(curves, suite, folder)
    return SweptSuite(out=folder, suite=suite, axes=curves, interrupted=interrupted)


def _axes(words: Sequence[str]) -> list[SweptAxis]:
    from nw_sim.axes import SweptAxis

    swept = [SweptAxis.of(each) for each in words]
    if not swept:
        raise UsageError("no axis to sweep", fix="add --axis friction=0.3..1.2")
    if len({axis.name for axis in swept}) < len(swept):
        raise UsageError("an axis is given twice", fix="give all of its values at once")
    return swept


def _along(axis: SweptAxis, base: Plan, request: Request) -> Plan:
    """Return the plan of a policy along an axis: what its suite perturbs and judges is left out."""
    from nw_eval.suite import new_suite

    settings = base.suite.model_dump(by_alias=True, exclude={"gate", "plugins"})
    settings["perturb"] = {axis.name: axis.values}
    suite = new_suite(settings, base.suite.source)
    changes = {field.name: getattr(request, field.name) for field in fields(request)}
    return plan(suite, **{**changes, "suite": None})


def _labels(names: Sequence[str]) -> list[str]:
    """Return names that tell policies apart."""
    return [f"{name} ({n + 1})" if names.count(name) > 1 else name for n, name in enumerate(names)]


def result_folder(out: Path | None, stem: str) -> Path:
    """Make the folder of several runs.

    Args:
        out: a new or empty one; None = `reports/<stem>-<number>`.
        stem: what its name begins with, such as `hurdles-sweep`.

    Raises:
        UsageError: it holds something.
        StoreError: it cannot be made.
    """
    try:
        if out is not None:
            if out.is_dir() and any(out.iterdir()):
                raise UsageError(f"{out} is not empty", fix="give a new folder with --out")
            made_place(out)
            return out
        name = re.sub(r"[^A-Za-z0-9_.-]+", "-", stem)
        for number in range(1, _MOST_FOLDERS):
            path = Path("reports") / f"{name}-{number:03d}"
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                path.mkdir()
            except FileExistsError:
                continue
            return path
    except OSError as error:
        raise StoreError(
            f"cannot make {error.filename}: {error.strerror}",
            fix="choose another folder with --out",
        ) from error
    raise StoreError(f"{_MOST_FOLDERS} folders {stem} exist", fix="choose one with --out")
