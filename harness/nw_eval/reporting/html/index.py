"""A page over many runs: what each came to, and how every scene went from run to run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nw_eval.gate.verdict import Verdict
from nw_eval.reporting.headline import headline_parts, part_of_suite
from nw_eval.reporting.html.environment import render
from nw_eval.reporting.tables.table import Bar
from nw_eval.results.provenance import RunInfo

_WIDTH, _HEIGHT = 120.0, 28.0
"""Of a trend's drawing."""
_LEVELS = (0.0, 0.1, 0.25, 0.5, 0.75)
"""Shares of success lost over which a cell is drawn one step stronger."""


@dataclass(frozen=True, kw_only=True)
class ListedRun:
    """One run of the page."""

    folder: str
    """As one would type it."""
    href: str | None
    """Of its own page, relative to this one; None without a page."""
    info: RunInfo
    verdict: Verdict

    @property
    def suite(self) -> str:
        """The suite's name."""
        return str(self.info.suite.get("name", "suite"))

    @property
    def parts(self) -> tuple[str, ...]:
        """Of its headline, without the verdict's word."""
        return headline_parts(self.verdict, self.info)[1:]

    @property
    def part(self) -> str:
        """Of how many of its suite's scenes it has results; nothing if of all."""
        return part_of_suite(self.verdict, self.info)

    @property
    def bar(self) -> Bar | None:
        """Mean success, drawn."""
        if self.verdict.success is None:
            return None
        interval = self.verdict.interval
        return Bar(value=self.verdict.success, interval=interval, mark=self.verdict.bar)


@dataclass(frozen=True, kw_only=True)
class Trend:
    """Success from run to run: of a scene, or of all together."""

    name: str
    means: tuple[float | None, ...]
    """In the order of the runs; None where a run has none."""

    @property
    def points(self) -> tuple[tuple[float, float], ...]:
        """Of its drawing, those that there are."""
        step = _WIDTH / max(1, len(self.means) - 1)
        return tuple(
            (round(place * step, 1), round(_HEIGHT * (1.0 - mean), 1))
            for place, mean in enumerate(self.means)
            if mean is not None
        )

    @property
    def levels(self) -> tuple[int, ...]:
        """How strongly to draw each, from 0, all was reached, to 5."""
        return tuple(
            0 if mean is None else sum(1.0 - mean > least for least in _LEVELS)
            for mean in self.means
        )

    @property
    def change(self) -> float | None:
        """The last run's success less that of the one before it, of those that have one."""
        known = [mean for mean in self.means if mean is not None]
        return known[-1] - known[-2] if len(known) > 1 else None


@dataclass(frozen=True, kw_only=True)
class SuiteTrends:
    """The runs of one suite, the oldest first."""

    suite: str
    runs: tuple[ListedRun, ...]
    trends: tuple[Trend, ...]
    """All scenes together first, then each in alphabetical order."""

    @property
    def panels(self) -> int:
        """How many panels of starts the runs met; between two of these starts differ too."""
        return len({(run.info.suite_digest, run.info.drawn_from) for run in self.runs})


def render_index(runs: Sequence[ListedRun], unread: Sequence[str]) -> str:
    """Return the page.

    Args:
        runs: in any order.
        unread: a sentence on each run that could not be read.
    """
    ordered = sorted(runs, key=lambda run: (run.info.started, run.info.id, run.folder))
    suites = sorted({run.suite for run in ordered})
    return render(
        "index.html.j2",
        runs=ordered[::-1],
        unread=tuple(unread),
        suites=[_trends(suite, [run for run in ordered if run.suite == suite]) for suite in suites],
    )


def _trends(suite: str, runs: Sequence[ListedRun]) -> SuiteTrends:
    means = [{item.scene: item.mean for item in run.verdict.per_scene} for run in runs]
    scenes = sorted({scene for each in means for scene in each})
    return SuiteTrends(
        suite=suite,
        runs=tuple(runs),
        trends=(
            Trend(name="all scenes", means=tuple(run.verdict.success for run in runs)),
            *(
                Trend(name=scene, means=tuple(each.get(scene) for each in means))
                for scene in scenes
            ),
        ),
    )
