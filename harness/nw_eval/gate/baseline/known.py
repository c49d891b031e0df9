"""What the baseline scored, as rows: what its own policy would score again, bit for bit."""

from __future__ import annotations

from collections.abc import Iterable

from nw_eval.results.bank import Panel
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row, from_dict
from nw_eval.suite import Trial

_FROM_START = (
    *("success", "completed", "outcome", "end_reason"),
    *("waypoints_reached", "waypoints_total"),
)
_NO_TIMES = dict.fromkeys(("physics_s", "render_s", "policy_s", "log_s", "wall_s"), 0.0)


def known_rows(panel: Panel, run: RunInfo, trials: Iterable[Trial]) -> tuple[Row, ...]:
    """Return a panel's results as rows, taken over (`Row.cached`): they cost this run no time.

    They are for judging only. What a bank does not hold of a trial, its steps and digests, they do
    not hold either.

    Args:
        panel: of a bank.
        run: of the bank's own policy.
        trials: of all the panel's starts in scenes that the run has.
    """
    starts = {(*start.stratum, start.seed_index): start for start in panel.starts}
    rows: list[Row] = []
    for trial in trials:
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
            **{name: getattr(start, name) for name in _FROM_START},
            **_NO_TIMES,
        }
        rows.append(from_dict(known))
    return tuple(rows)
