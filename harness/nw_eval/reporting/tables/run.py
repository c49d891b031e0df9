"""Tables of the run as a whole: where its time went, what ran on what, and what was taken over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nw_base.digest import digest_of
from nw_base.plural import plural
from nw_eval.reporting.tables.table import Table
from nw_gate.results.labels import KNOWN
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row


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
        f" {taken_over(run, rows)}".rstrip()
        + (_OF_RENDER if spent.renders else ""),
    )


_OF_RENDER = (
    " render draws the policy's camera images, or, for a policy without cameras, those that logs "
    "of failed trials keep (`--record none` saves them)."
)


_STAGES = ("setup", "sense", "render", "policy", "physics", "log")
"""Those that rows have the times of, each in its column."""


@dataclass(frozen=True, kw_only=True)
class StageTime:
    """Time of one stage over all trials."""

    name: str
    seconds: float
    ms_per_step: float  # Per control step.
    share: float  # Of all workers' wall time.


@dataclass(frozen=True, kw_only=True)
class Throughput:
    """Stages in their order, those of a control step after `setup`, and the time they simulated.

    `waiting` is what workers spent outside of trials: they were started, or the others' trials of a
    round went on, or the journal was written.
    """

    stages: tuple[StageTime, ...]
    sim_s: float
    real_time_factor: float  # Simulated over wall time, of one worker.

    @property
    def renders(self) -> bool:
        """Whether any time went into images."""
        return any(stage.name == "render" and stage.seconds > 0.0 for stage in self.stages)


def throughput(rows: Sequence[Row], info: RunInfo) -> Throughput:
    """Return the time of each stage. Rows from the cache took none and are left out."""
    run = [row for row in rows if not row.cached]
    times = {name: f"{name}_s" for name in _STAGES}
    sums: dict[str, float] = {
        column: sum(getattr(row, column) for row in run)
        for column in ("steps", "wall_s", "sim_s", *times.values())
    }
    steps, trials, sim = sums["steps"], sums["wall_s"], sums["sim_s"]
    named = {name: sums[column] for name, column in times.items()}
    # Clocks that overlap by a rounding must not make a negative stage.
    named["other"] = max(0.0, trials - sum(named.values()))
    named["waiting"] = max(0.0, info.wall_s * min(info.workers, len(run)) - trials)
    wall = trials + named["waiting"]
    return Throughput(
        stages=tuple(
            StageTime(
                name=name,
                seconds=seconds,
                ms_per_step=1000.0 * seconds / steps if steps else 0.0,
                share=seconds / wall if wall else 0.0,
            )
            for name, seconds in named.items()
        ),
        sim_s=sim,
        real_time_factor=sim / trials if trials else 0.0,
    )


def taken_over(run: RunInfo, rows: Sequence[Row]) -> str:
    """Return how many results the cache of trials had, and how many of them ran again.

    Empty where it had none.
    """
    hits = sum(row.cached for row in rows)
    again = 0 if run.cache is None else run.cache.reexecuted
    if not hits and not again:
        return ""
    text = f"Cache: {hits} of {plural(len(rows), 'result')} reused."
    if run.cache is None or not again:
        return text
    wrong = len(run.cache.differing)
    re_run = f"{plural(again, 'trial')} {'was' if again == 1 else 'were'} re-run as a check"
    return f"{text} {re_run} and {f'{wrong} differed' if wrong else 'matched'}."


def provenance_table(run: RunInfo) -> Table:
    """Return what ran on what."""
    weights = f"checkpoint {run.policy.checkpoint_digest[:12]}"
    commit = f", commit {run.code.commit[:12]}{' with changes' if run.code.dirty else ''}"
    facts = {
        **{label_name(key): value for key, value in run.labels.items()},
        "run": run.id,
        "started": run.started,
        "suite": f"{run.suite_file}, {digest_of(run.suite)[:12]}",
        "seed set": f"{run.suite_digest[:12]} (same robot, protocol, seed, episode and "
        f"perturbations: same initial states), {run.panel}",
        "policy": f"{run.policy.folder_name}, {run.policy.origin or weights}",
        "card and checkpoint": run.policy.short_digest,
        "processor": run.policy.dependence,
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


def label_name(key: str) -> str:
    """Return what pages call a label; one of a user's own is told from our words."""
    return KNOWN.get(key, f"label {key}")


def _fetched(run: RunInfo) -> list[str]:
    """Return which revisions policy, robot and scenes are that came from elsewhere."""
    origins = [
        run.policy.fetched,
        run.robot_fetched,
        *(scene.fetched for scene in run.scenes.values()),
    ]
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
