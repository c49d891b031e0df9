"""Suites: what to run and what it must show.

A suite file becomes a frozen `Suite`; a suite and its scenes become `Trial`s, each with an identity
and a seed of its own that nothing else can move.
"""

from __future__ import annotations

from nw_base.trials import Trial, expand
from nw_eval.suite.load import (
    Draft,
    draft_of,
    draft_suite,
    find_suite,
    load_suite,
    suite_yaml,
    tier_problems,
)
from nw_eval.suite.model import Suite, json_schema, new_suite, override, with_robot
from nw_gate.settings import Gate

__all__ = [
    "Draft",
    "Gate",
    "Suite",
    "Trial",
    "draft_of",
    "draft_suite",
    "expand",
    "find_suite",
    "json_schema",
    "load_suite",
    "new_suite",
    "override",
    "suite_yaml",
    "tier_problems",
    "with_robot",
]
