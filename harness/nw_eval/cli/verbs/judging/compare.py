"""`nw-eval compare`: policies side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Put the policies of runs or baselines side by side: ranks, scenes, where they part."""

    runs: tyro.conf.Positional[tuple[str, ...]]
    """Folders of runs, and baselines; each is compared with the first by waypoints."""
    out: Path | None = None
    """A Markdown page to write."""
    picture: Path | None = None
    """A PNG of all scenes and policies to write."""
    confidence: float = 0.95
    """Of each interval alone, and of all ranks together."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.comparison import comparison_text

        found = api.compare(
            self.runs, out=self.out, picture=self.picture, confidence=self.confidence
        )
        print(comparison_text(found))
        for path in (self.out, self.picture):
            if path is not None:
                print(path)
        return 0
