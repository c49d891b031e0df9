"""nw-eval: may this policy checkpoint ship?

    report = nw_eval.run("smoke", policy="go1-parkour", trials=1)

Every public name is here, and is imported when it is first used; `__init__.pyi` shows editors what
each of them is.
"""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from warnings import warn

__version__ = "0.2.0"

_ROOMS = MappingProxyType(
    {
        "api": (
            "ActingPolicy",
            "BarPlan",
            "BisectedSeries",
            "AttributionPlan",
            "AttributedTrial",
            "Attribution",
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
            "sim2real",
            "bisect",
            "attribute",
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
            "rerun_layout",
            "rerun_recording",
            "report",
            "run",
            "save_baseline",
            "schema",
            "serve_policy",
            "show_baseline",
            "show_policy",
            "show_robot",
            "show_scene",
            "show_suite",
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
        ),
        "cards.card": ("Card",),
        "cards.load": ("ListedPolicy",),
        "engine.plan": ("Forecast", "Plan"),
        "errors": (
            "CodeError",
            "FetchError",
            "IncomparableError",
            "NwEvalError",
            "PluginError",
            "PolicyError",
            "PrerequisiteError",
            "SceneError",
            "StoreError",
            "SuiteError",
            "TrialError",
            "UsageError",
        ),
        "gate.ledger_report": ("LedgerReport",),
        "gate.side_by_side": ("PolicyComparison",),
        "gate.verdict": ("Comparison", "Verdict"),
        "hub.reference": ("Fetched",),
        "onboarding.probe.report": ("ProbeReport",),
        "onboarding.probe.summary": ("CardSummary",),
        "onboarding.robot_check": ("CheckedRobot", "RobotSummary"),
        "request": ("Request",),
        "results.bank": ("BaselineChange", "BaselineResults"),
        "results.row": ("Row",),
        "rollout.replaying.rescored": ("LogScores",),
        "rollout.replaying.reports": ("AttributionReport", "ReplayReport", "TakeoverReport"),
        "scenes.overview": ("SceneFigures",),
        "sensors.gallery": ("SeenCard",),
        "splat.files.format": ("SplatFormat",),
        "splat.gaussians": ("Gaussians", "SplatFigures"),
        "stats.agreement": ("Agreement",),
        "suite.axes": ("Axis",),
        "viewing.recording.track": ("WrittenRecording",),
    }
)
"""Where each public name is at home."""

_RENAMED = MappingProxyType(
    {
        "BankChange": "BaselineChange",
        "BlamePlan": "AttributionPlan",
        "BlameReport": "AttributionReport",
        "BlamedTrial": "AttributedTrial",
        "Blames": "Attribution",
        "SavedBank": "BaselineResults",
        "agree": "sim2real",
        "blame": "attribute",
    }
)
"""Names until 0.1, which are understood for one release."""

_HOMES = {name: room for room, names in _ROOMS.items() for name in names}

# One table says the names; the stub says them to whoever cannot run it.
__all__ = ["__version__", *_HOMES]  # noqa: PLE0604  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    if name in _RENAMED:
        now = _RENAMED[name]
        warn(f"nw_eval.{name} is now nw_eval.{now}", DeprecationWarning, stacklevel=2)
        return globals()[now] if now in globals() else __getattr__(now)
    if name not in _HOMES:
        raise AttributeError(f"module 'nw_eval' has no attribute {name!r}")
    value = getattr(import_module(f"nw_eval.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
