"""What the baseline scored, as rows: what its own policy would score again, bit for bit."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.results.bank import SavedBank
from nw_eval.results.bank.manifest import machine_of
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row, from_dict
from nw_eval.suite.model import new_suite
from nw_eval.suite.trials import expand

_FROM_START = (
    *("success", "completed", "outcome", "end_reason"),
    *("waypoints_reached", "waypoints_total"),
)
_NO_TIMES = dict.fromkeys(("physics_s", "render_s", "policy_s", "log_s", "wall_s"), 0.0)


@dataclass(frozen=True, kw_only=True)
class _Place:
    """A scene, as its trials' identities need it."""

    name: str
    task: str
    digest: str


def known_rows(run: RunInfo, bank: SavedBank) -> tuple[Row, ...]:
    """Return a bank's results as rows, taken over (`Row.cached`): they cost this run no time.

    They are for judging only. What a bank does not hold of a trial, its steps and digests, they do
    not hold either.

    Args:
        run: of the bank's own policy.
        bank: which holds for the run: the panel of its class of machine, or else the first.
    """
    panel = bank.panel_of(machine_of(run)) or bank.panels[0]
    starts = {(*start.stratum, start.seed_index): start for start in panel.starts}
    suite = new_suite({**run.suite, "trials": bank.manifest.starts})
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
            **{name: getattr(start, name) for name in _FROM_START},
            **_NO_TIMES,
        }
        rows.append(from_dict(known))
    return tuple(rows)
