"""What one can do with nw-eval. The command line and other doors call these and nothing deeper.

The hall of the house: the only room that sees both wings, the one that makes rows (scenes, sim,
sensors, policies, rollout, engine) and the one that reads them (results, stats, gate, reporting).
"""

from __future__ import annotations

from nw_eval.api.places import (
    CheckedScene,
    ListedScene,
    WarmUp,
    check_scenes,
    list_scenes,
    render_scenes,
    show_scene,
    warmup,
)
from nw_eval.api.policies import (
    CardDraft,
    FoldedGraph,
    ServedPolicy,
    check_policy,
    fold_policy,
    init_policy,
    list_policies,
    serve_policy,
    show_policy,
)
from nw_eval.api.replays import replay
from nw_eval.api.running.comparisons import compare
from nw_eval.api.running.evaluation import ActingPolicy, evaluate
from nw_eval.api.running.plans import check, plan
from nw_eval.api.running.reports import RunReport, report
from nw_eval.api.running.rows import read_rows
from nw_eval.api.running.runs import run
from nw_eval.api.schemas import schema
from nw_eval.api.sensors import ListedSensor, draw_sensors, list_sensors
from nw_eval.api.splats import WrittenSplat, splat_convert, splat_info, splat_render
from nw_eval.api.suites import ListedSuite, list_suites
from nw_eval.request import Request

__all__ = [
    "ActingPolicy",
    "CardDraft",
    "CheckedScene",
    "FoldedGraph",
    "ListedScene",
    "ListedSensor",
    "ListedSuite",
    "Request",
    "RunReport",
    "ServedPolicy",
    "WarmUp",
    "WrittenSplat",
    "check",
    "check_policy",
    "check_scenes",
    "compare",
    "draw_sensors",
    "evaluate",
    "fold_policy",
    "init_policy",
    "list_policies",
    "list_scenes",
    "list_sensors",
    "list_suites",
    "plan",
    "read_rows",
    "render_scenes",
    "replay",
    "report",
    "run",
    "schema",
    "serve_policy",
    "show_policy",
    "show_scene",
    "splat_convert",
    "splat_info",
    "splat_render",
    "warmup",
]
