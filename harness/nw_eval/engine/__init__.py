"""Many trials: an order, worker processes, a journal, and what happens when something breaks."""

from nw_eval.engine.listener import Listener, Silence
from nw_eval.engine.order import in_order
from nw_eval.engine.plan import Plan, default_time_limit, plan_jobs
from nw_eval.engine.prepare import build_splats, needs_splats
from nw_eval.engine.run import RunOutcome, default_workers, run_trials

__all__ = [
    "Listener",
    "Plan",
    "RunOutcome",
    "Silence",
    "build_splats",
    "default_time_limit",
    "default_workers",
    "in_order",
    "needs_splats",
    "plan_jobs",
    "run_trials",
]
