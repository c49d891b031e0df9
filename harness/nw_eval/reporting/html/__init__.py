"""report.html: one file that holds all it shows, and asks no network for anything."""

from __future__ import annotations

from nw_eval.reporting.html.index import ListedRun, render_index
from nw_eval.reporting.html.page import render_html

__all__ = ["ListedRun", "render_html", "render_index"]
