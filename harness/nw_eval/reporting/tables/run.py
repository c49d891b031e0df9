"""Tables of the run as a whole: where its time went, and what ran on what."""

from __future__ import annotations

from collections.abc import Sequence

from nw_eval.plural import plural
from nw_eval.reporting.tables.table import Table
from nw_eval.reporting.taken_over import taken_over
from nw_eval.reporting.throughput import throughput
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row
from nw_eval.suite.digest import digest_of


def throughput_table(rows: Sequence[Row], run: RunInfo) -> Table:
    """Return where the time went."""
    spent = throughput(rows, run)
    # A run that was resumed knows the time of its last part only.
    wall = max(run.wall_s, sum(row.wall_s for row in rows if not row.cached) / run.workers)
    rate = 60.0 * len(rows) / wall if wall > 0 else 0.0
    return Table(
        title="Where the time went",
        columns=("stage", "seconds", "ms per control step", "share"),
        rows=tuple(
            (
                stage.name,
                f"{stage.seconds:.1f}",
                f"{stage.ms_per_step:.2f}",
                f"{100 * stage.share:.0f} %",
            )
            for stage in spent.stages
            if not all(row.cached for row in rows)  # Where nothing ran no time went anywhere.
        ),
        numbers=frozenset({"seconds", "ms per control step", "share"}),
        note=f"{rate:.1f} trials per minute on {plural(run.workers, 'worker')}; "
        f"{spent.sim_s:.0f} s simulated, {spent.real_time_factor:.1f} times real time per worker."
        f" {taken_over(run, rows)}".rstrip(),
    )


def provenance_table(run: RunInfo) -> Table:
    """Return what ran on what."""
    weights = f"checkpoint {run.policy.checkpoint_digest[:12]}"
    commit = f", commit {run.code.commit[:12]}{' with changes' if run.code.dirty else ''}"
    facts = {
        "run": run.id,
        "started": run.started,
        "suite": f"{run.suite_file}, {digest_of(run.suite)[:12]}",
        "panel of starts": f"{run.suite_digest[:12]} (same robot, protocol, seed, episode and "
        f"perturbations: same starts), {run.panel}",
        "policy": f"{run.policy.name}, {run.policy.origin or weights}",
        "scenes": f"{_scenes(run)}, {plural(sum(run.planned.values()), 'trial')} planned"
        + _saved(run),
        "fetched": "; ".join(_fetched(run)),
        "baseline": ""
        if run.baseline is None
        else f"{run.baseline.name}, {run.baseline.sha256[:12]}",
        "part": "" if run.shard is None else f"{run.shard}, of plan {run.shard.plan[:12]}",
        "merged of": _parts(run),
        "renderer": run.renderer or "none",
        "fence": run.fence,
        "nw-eval": f"{run.code.version}{commit if run.code.commit else ''}",
        "code": run.code.digest[:12],
        "versions": ", ".join(f"{name} {number}" for name, number in run.versions.items()),
        "machine": f"{run.machine.cpu}, {run.machine.cores} cores, {run.machine.system}, "
        f"Python {run.machine.python}",
        "rows": run.rows_digest[:12],
        "Merkle root": run.merkle_root,
    }
    return Table(
        title="Provenance",
        columns=("what", "value"),
        rows=tuple((name, value) for name, value in facts.items() if value),
    )


def _fetched(run: RunInfo) -> list[str]:
    """Return which revisions policy and scenes are that came from a hub."""
    origins = [run.policy.fetched, *(scene.fetched for scene in run.scenes.values())]
    return [f"{each.reference} {each.revision[:12]}" for each in origins if each is not None]


def _parts(run: RunInfo) -> str:
    """Return of which parts a run was merged, and where they ran; nothing if it was run whole."""
    if not run.parts:
        return ""
    hosts = ", ".join(sorted({part.host for part in run.parts}))
    return f"{plural(len(run.parts), 'part')}, run on {hosts}"


def _scenes(run: RunInfo) -> str:
    """Return how many scenes the run has, and how many of its suite's that is if not all."""
    count = len(run.scenes)
    return f"{count} of the suite's {count + len(run.left_out)}" if run.left_out else f"{count}"


def _saved(run: RunInfo) -> str:
    """Return how many trials of the budget were judged, where not all were."""
    if run.stop is None:
        return ""
    most = sum(scene.trials for scene in run.scenes.values())
    return f": {sum(run.planned.values())} of at most {most} were judged"
