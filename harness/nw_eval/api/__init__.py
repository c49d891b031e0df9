"""What one can do with nw-eval. The command line and other doors call these and nothing deeper.

The hall of the house: the only room that sees both wings, the one that makes rows (scenes, sim,
sensors, policies, rollout, engine) and the one that reads them (results, stats, gate, reporting).
"""

from __future__ import annotations

import importlib
import os
import sys

from nw_eval.api.attribution import AttributedTrial, Attribution, AttributionPlan, attribute
from nw_eval.api.baselines import (
    CheckedBaseline,
    ListedBaseline,
    ShownBaseline,
    check_baseline,
    diff_baselines,
    list_baselines,
    show_baseline,
)
from nw_eval.api.baselines_saved import SavedBaseline, save_baseline
from nw_eval.api.baselines_verified import VerifiedBaseline, verify_baseline
from nw_eval.api.cache import CacheCleanup, CacheUse, cache_info, prune_cache, verify_cache
from nw_eval.api.cause import FoundCause, find_cause
from nw_eval.api.comparisons import compare, sim2real
from nw_eval.api.hub import PushedScene, fetch_policy, fetch_robot, fetch_scene, push_scene
from nw_eval.api.ledgers import read_ledger, record_verdict
from nw_eval.api.merges import merge
from nw_eval.api.plans import check, plan
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
from nw_eval.api.replays import (
    foxglove_layout,
    log_scores,
    replay,
    rerun_layout,
    rerun_recording,
    take_over,
)
from nw_eval.api.reports import RunReport, judge, report
from nw_eval.api.robots import (
    ListedRobot,
    RobotDraft,
    check_robot,
    init_robot,
    list_robots,
    show_robot,
)
from nw_eval.api.runs import ActingPolicy, evaluate, run
from nw_eval.api.saved_run import read_rows
from nw_eval.api.scenes import (
    CheckedScene,
    ListedScene,
    WarmUp,
    check_scenes,
    list_scenes,
    render_scenes,
    show_scene,
    warmup,
)
from nw_eval.api.schemas import schema
from nw_eval.api.sensors import ListedSensor, draw_sensors, list_sensors
from nw_eval.api.series import BisectedSeries, bisect
from nw_eval.api.site import RunIndex, WrittenSite, index_runs, write_site
from nw_eval.api.splats import WrittenSplat, splat_convert, splat_info, splat_render
from nw_eval.api.suites import ListedSuite, ShownSuite, list_suites, show_suite
from nw_eval.api.surfaces import (
    Published,
    Reporter,
    Surfaces,
    check_surfaces,
    publish,
    publish_error,
)
from nw_eval.api.sweeping import SweptSuite, sweep
from nw_eval.api.trial_plans import BarPlan, ShardPlan, TrialPlan, plan_shards, plan_trials
from nw_eval.api.verifying import VerifiedRun, verify
from nw_eval.api.watching import WatchedCheckpoint, WatchedTraining, watch
from nw_gate.results.request import Request


def _see_to_mujoco() -> None:
    """Import MuJoCo without OpenGL, of which nothing here has need, where it cannot be with it."""
    name = os.environ.get("MUJOCO_GL", "disable")
    if name == "disable" or "mujoco" in sys.modules:
        return
    try:
        importlib.import_module("mujoco")
    except Exception:  # noqa: BLE001 - of PyOpenGL, where a library of the system is missing.
        os.environ["MUJOCO_GL"] = "disable"
        importlib.import_module("mujoco")
        os.environ["MUJOCO_GL"] = name


_see_to_mujoco()

__all__ = [
    "ActingPolicy",
    "AttributedTrial",
    "Attribution",
    "AttributionPlan",
    "BarPlan",
    "BisectedSeries",
    "CacheCleanup",
    "CacheUse",
    "CardDraft",
    "CheckedBaseline",
    "CheckedScene",
    "FoldedGraph",
    "FoundCause",
    "ListedBaseline",
    "ListedRobot",
    "ListedScene",
    "ListedSensor",
    "ListedSuite",
    "Published",
    "PushedScene",
    "Reporter",
    "Request",
    "RobotDraft",
    "RunIndex",
    "RunReport",
    "SavedBaseline",
    "ServedPolicy",
    "ShardPlan",
    "ShownBaseline",
    "ShownSuite",
    "Surfaces",
    "SweptSuite",
    "TrialPlan",
    "VerifiedBaseline",
    "VerifiedRun",
    "WarmUp",
    "WatchedCheckpoint",
    "WatchedTraining",
    "WrittenSite",
    "WrittenSplat",
    "attribute",
    "bisect",
    "cache_info",
    "check",
    "check_baseline",
    "check_policy",
    "check_robot",
    "check_scenes",
    "check_surfaces",
    "compare",
    "diff_baselines",
    "draw_sensors",
    "evaluate",
    "fetch_policy",
    "fetch_robot",
    "fetch_scene",
    "find_cause",
    "fold_policy",
    "foxglove_layout",
    "index_runs",
    "init_policy",
    "init_robot",
    "judge",
    "list_baselines",
    "list_policies",
    "list_robots",
    "list_scenes",
    "list_sensors",
    "list_suites",
    "log_scores",
    "merge",
    "plan",
    "plan_shards",
    "plan_trials",
    "prune_cache",
    "publish",
    "publish_error",
    "push_scene",
    "read_ledger",
    "read_rows",
    "record_verdict",
    "render_scenes",
    "replay",
    "report",
    "rerun_layout",
    "rerun_recording",
    "run",
    "save_baseline",
    "schema",
    "serve_policy",
    "show_baseline",
    "show_policy",
    "show_robot",
    "show_scene",
    "show_suite",
    "sim2real",
    "splat_convert",
    "splat_info",
    "splat_render",
    "sweep",
    "take_over",
    "verify",
    "verify_baseline",
    "verify_cache",
    "warmup",
    "watch",
    "write_site",
]
