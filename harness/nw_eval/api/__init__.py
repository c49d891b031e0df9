"""What one can do with nw-eval. The command line and other doors call these and nothing deeper.

The hall of the house: the only room that sees both wings, the one that makes rows (scenes, sim,
sensors, policies, rollout, engine) and the one that reads them (results, stats, gate, report).
"""

from __future__ import annotations

from nw_eval.api.message import Message, write_text
from nw_eval.api.places import check_scenes, list_scenes, render_scenes, show_scene, warmup
from nw_eval.api.plans import check, plan
from nw_eval.api.policies import (
    check_policy,
    fold_policy,
    init_policy,
    list_policies,
    serve_policy,
    show_policy,
)
from nw_eval.api.reports import RunReport, report
from nw_eval.api.runs import replay, run
from nw_eval.api.schemas import schema
from nw_eval.api.senses import draw_sensors, list_sensors
from nw_eval.api.splats import splat_convert, splat_info, splat_render
from nw_eval.api.suites import list_suites
from nw_eval.request import Request

__all__ = [
    "Message",
    "Request",
    "RunReport",
    "check",
    "check_policy",
    "check_scenes",
    "draw_sensors",
    "fold_policy",
    "init_policy",
    "list_policies",
    "list_scenes",
    "list_sensors",
    "list_suites",
    "plan",
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
    "write_text",
]
