"""Reports: verdict and rows in, text for people out. Imports no simulation."""

from __future__ import annotations

from nw_eval.report.console import print_summary
from nw_eval.report.headline import blind_spot, headline
from nw_eval.report.markdown import render_markdown, write_report

__all__ = ["blind_spot", "headline", "print_summary", "render_markdown", "write_report"]
