"""The gate: rows in, verdict out. Imports no simulation."""

from __future__ import annotations

from nw_eval.gate.absolute import judge
from nw_eval.gate.verdict import EXIT_CODES, SceneScore, Verdict

__all__ = ["EXIT_CODES", "SceneScore", "Verdict", "judge"]
