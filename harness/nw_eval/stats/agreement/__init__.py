"""Sim-to-real agreement: does the simulator say which policy does better on the robot?"""

from __future__ import annotations

from nw_eval.stats.agreement.agree import Agreement, AgreementFigure, Gap, agreement
from nw_eval.stats.agreement.figures import FigureName, mmrv, pearson, spearman
from nw_eval.stats.agreement.floor import Floor, perfect_simulator

__all__ = [
    "Agreement",
    "AgreementFigure",
    "FigureName",
    "Floor",
    "Gap",
    "agreement",
    "mmrv",
    "pearson",
    "perfect_simulator",
    "spearman",
]
