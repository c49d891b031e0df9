"""report.html: one file that holds all it shows, and asks no network for anything."""

from __future__ import annotations

from nw_eval.reporting.html.page import render_html

__all__ = ["render_html"]
