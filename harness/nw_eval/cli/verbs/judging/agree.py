"""`nw-eval agree`: does the simulator rank policies as the robot does?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True, kw_only=True)
class Agree:
    """Say how well runs agree with results on the robot, and what a perfect simulator shows."""

    real: tyro.conf.Positional[Path]
    """A CSV with the columns policy, scene, trials, success."""
    runs: tyro.conf.Positional[tuple[str, ...]]
    """Folders of runs, and baselines, of those policies."""
    confidence: float = 0.95
    """Of each interval."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.agreement import agreement_text

        print(agreement_text(api.agree(self.real, self.runs, confidence=self.confidence)))
        return 0
