"""`nw-eval sweep`: how much a policy bears, along axes of perturbation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.verbs.shared import AllowCode, NoCache, Scenes, Suite, Workers
from nw_gate.results.request import Request

if TYPE_CHECKING:
    from nw_eval.api import SweptSuite


@dataclass(frozen=True, kw_only=True)
class SweepAxes:
    """Evaluate a suite over values of an axis, such as friction or payload; show where it fails.

    Writes sweep.md, sweep.png and sweep.parquet. The suite's own perturbations, bar and baseline
    are ignored. Trials of earlier sweeps are reused. If the trials are too few to show any drop,
    the output says how many are needed.
    """

    suite: Suite
    axis: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Axis and values, at least one: friction=0.3..1.2 (7 values), payload=0..6:4, push=0,0.5,1."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """A shipped policy's name, a policy folder, a card, or hub:org/name[@revision] (default: the
    suite's policy)."""
    baseline: str | None = None
    """Another policy to compare with, on the same trials and in the same picture."""
    trials: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None
    """Trials per value and scene (default: the suite's number)."""
    scenes: Scenes = None
    seed: int | None = None
    """Use a different seed (default: the suite's)."""
    out: Path | None = None
    """A new folder (default: `reports/<suite>-sweep-<number>`)."""
    workers: Workers = None
    confidence: float = 0.95
    """Confidence level, per interval and jointly for the comparisons along a curve."""
    no_cache: NoCache = False
    allow_code: AllowCode = False

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.final_output import tell
        from nw_eval.cli.terminal.interruption import INTERRUPTED
        from nw_eval.cli.terminal.progress import RunProgress

        request = Request(
            suite=self.suite,
            policy=self.policy,
            trials=self.trials,
            scenes=self.scenes,
            seed=self.seed,
            allow_code=self.allow_code,
        )
        with RunProgress() as progress:
            swept = api.sweep(
                request,
                self.axis,
                out=self.out,
                baseline=self.baseline,
                workers=self.workers,
                cache=not self.no_cache,
                confidence=self.confidence,
                listener=progress,
            )
        print(sweep_text(swept))
        if swept.interrupted:
            tell("interrupted; the same command reuses the finished trials")
            return INTERRUPTED
        return 0


def sweep_text(swept: SweptSuite) -> str:
    """Return the tables of a sweep, what they say, and where its files are."""
    from nw_eval.reporting.sweep import sweep_table, sweep_words

    parts: list[str] = []
    for curves in swept.axes:
        table = sweep_table(curves)
        right = [place for place, name in enumerate(table.columns) if name in table.numbers]
        parts.append("\n".join(aligned([table.columns, *table.rows], right=right)))
        parts.append("\n".join(sweep_words(curves)))
    if swept.axes:
        parts.append("\n".join(str(swept.out / f"sweep.{end}") for end in ("md", "png", "parquet")))
    return "\n\n".join(parts)
