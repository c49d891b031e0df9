"""Banks: what a baseline scored from every start of a panel, kept in git beside the suite.

A bank is one file, `reports/baselines/<suite>/<name>.parquet`: the results of S scenes by M starts
without wall times, once for each class of machine that they were run on, and a manifest.
"""

from __future__ import annotations

from nw_eval.results.bank.manifest import BankKey, Manifest, PanelInfo
from nw_eval.results.bank.start import Panel, SavedBank, Start, Stratum, score, trajectory

__all__ = [
    "BankKey",
    "Manifest",
    "Panel",
    "PanelInfo",
    "SavedBank",
    "Start",
    "Stratum",
    "score",
    "trajectory",
]
