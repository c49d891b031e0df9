"""Reports: verdict and rows in, text for people out. Imports no simulation."""

from __future__ import annotations

from nw_eval.reporting.console import print_summary
from nw_eval.reporting.headline import blind_spot, headline
from nw_eval.reporting.markdown import render_markdown, write_report

__all__ = ["blind_spot", "headline", "print_summary", "render_markdown", "write_report"]
