"""Pages over many runs: an index of them, and a leaderboard.

The index shows what each run came to, and how every scene went from run to run. The leaderboard
shows policies by suites and tasks, and every suite scene by scene.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from nw_eval.gate.side_by_side import PolicyComparison
from nw_eval.gate.verdict import Verdict
from nw_eval.reporting.headline import headline_parts, part_of_suite
from nw_eval.reporting.html.environment import render
from nw_eval.reporting.side_by_side import ranks_text
from nw_eval.reporting.tables.table import Bar
from nw_eval.results.provenance import RunInfo
from nw_eval.stats.interval import Interval

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
        return tuple(0 if mean is None else _level(mean) for mean in self.means)

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


@dataclass(frozen=True, kw_only=True)
class BoardRun:
    """A run of the board.

    Attributes:
        info: its run.json.
        verdict: as it was begun.
        href: of its own report, relative to the page.
    """

    info: RunInfo
    verdict: Verdict
    href: str

    @property
    def part(self) -> str:
        """Of how many of its suite's scenes it has results; nothing if of all."""
        return part_of_suite(self.verdict, self.info)

    @property
    def identity(self) -> tuple[str, str]:
        """The policy: its name, and the digest of its checkpoint."""
        return self.info.policy.name, self.info.policy.checkpoint_digest


@dataclass(frozen=True, kw_only=True)
class BoardSection:
    """Runs of one suite that compare with one another.

    Attributes:
        title: the suite's name, with a number where its runs do not all compare.
        note: why they do not; empty where they do.
        comparison: of their policies, in the order of `runs`.
        runs: one for each.
        pictures: JPEGs by scene, as far as there are any.
    """

    title: str
    note: str
    comparison: PolicyComparison
    runs: tuple[BoardRun, ...]
    pictures: Mapping[str, bytes]

    @property
    def order(self) -> list[int]:
        """Places of the policies, the best first."""
        policies = self.comparison.policies
        return sorted(range(len(policies)), key=lambda i: (-policies[i].mean, policies[i].label))

    @property
    def has_splits(self) -> bool:
        """Whether any of the policies says in which scenes it was trained."""
        return any(each.split for run in self.runs for each in run.info.scenes.values())

    def split(self, place: int, scene: str) -> str:
        """Return whether a policy was trained in a scene: `train` or `eval`, or nothing."""
        known = self.runs[place].info.scenes.get(scene)
        return "" if known is None else known.split or ""

    def split_mean(self, place: int, split: str) -> float | None:
        """Return a policy's mean success over its `train` or its `eval` scenes; None without any.

        Scenes weigh equally. Those that the verdict takes for informational do not count.
        """
        tiers = {item.scene: item.tier for item in self.runs[place].verdict.per_scene}
        found = [
            each.means[place]
            for each in self.comparison.scenes
            if self.split(place, each.scene) == split and tiers.get(each.scene) != "informational"
        ]
        return sum(found) / len(found) if found else None

    def level(self, mean: float) -> int:
        """Return how strongly a cell is drawn: 0 where all was reached, to 5."""
        return _level(mean)

    def bar(self, place: int) -> Bar:
        """Return the drawing of a policy's success."""
        policy = self.comparison.policies[place]
        return Bar(value=policy.mean, interval=policy.interval)

    def rank(self, place: int) -> str:
        """Return the ranks that a policy may have; nothing where it is alone."""
        policies = self.comparison.policies
        return ranks_text(policies[place]) if len(policies) > 1 else ""


@dataclass(frozen=True, kw_only=True)
class BoardStanding:
    """A policy in one column: success, its interval, its ranks (of a task none), and its report."""

    mean: float
    interval: Interval
    rank: str
    href: str


@dataclass(frozen=True, kw_only=True)
class BoardLine:
    """A policy over all columns.

    Attributes:
        name: of the policy.
        checkpoint: the beginning of its checkpoint's digest; empty where names tell all apart.
        standings: by column, None where it has no run.
    """

    name: str
    checkpoint: str
    standings: tuple[BoardStanding | None, ...]


def render_board(title: str, sections: Sequence[BoardSection], left_out: Sequence[str]) -> str:
    """Return the page.

    Args:
        title: above it.
        sections: in their order.
        left_out: a sentence for each run that the page does not have.
    """
    columns, lines = _lines(sections)
    return render(
        "site.html.j2",
        title=title,
        sections=tuple(sections),
        columns=columns,
        lines=lines,
        left_out=tuple(left_out),
        suites=len({section.comparison.suite for section in sections}),
        percent=f"{100 * sections[0].comparison.confidence:.4g} %" if sections else "",
    )


def _lines(sections: Sequence[BoardSection]) -> tuple[list[str], list[BoardLine]]:
    """Return the names of the columns, and a line for each policy, the best of the first on top."""
    columns: list[str] = []
    standings: dict[tuple[str, str], dict[int, BoardStanding]] = {}
    for section in sections:
        tasks = section.comparison.tasks
        shown = [None, *tasks] if len(tasks) > 1 else [None]
        for task in shown:
            for place, (policy, run) in enumerate(
                zip(section.comparison.policies, section.runs, strict=True)
            ):
                found = policy if task is None else task.estimates[place]
                own = standings.setdefault(run.identity, {})
                # Of two runs of one policy in one suite, the first is the board's.
                own.setdefault(
                    len(columns),
                    BoardStanding(
                        mean=found.mean,
                        interval=found.interval,
                        rank=section.rank(place) if task is None else "",
                        href=run.href,
                    ),
                )
            columns.append(section.title if task is None else f"{section.title}: {task.task}")
    names = [name for name, _ in standings]
    order = sorted(
        standings,
        key=lambda key: (
            [-standings[key][c].mean if c in standings[key] else 1.0 for c in range(len(columns))],
            key,
        ),
    )
    return columns, [
        BoardLine(
            name=name,
            checkpoint=digest[:8] if names.count(name) > 1 else "",
            standings=tuple(standings[name, digest].get(c) for c in range(len(columns))),
        )
        for name, digest in order
    ]


def _level(mean: float) -> int:
    return sum(1.0 - mean > least for least in _LEVELS)


def render_training(
    title: str,
    suite: str,
    checkpoints: Sequence[Mapping[str, Any]],
    *,
    best: int | None,
    confidence: float,
    obstacles: Sequence[str] = (),
) -> str:
    """Return the page of a training: success over its steps, and a line for each checkpoint.

    Args:
        title: the training's name.
        suite: the suite's name.
        checkpoints: in order of their steps, as `nw_eval.WatchedCheckpoint` has them.
        best: the step of the one with the largest mean success.
        confidence: of each bound of success.
        obstacles: why no checkpoint can PASS beside one that never fails, a sentence each.
    """
    used = [each for each in checkpoints if each["success"] is not None]
    steps = [each["step"] for each in used]
    first, last = (min(steps), max(steps)) if steps else (0, 0)
    across = max(1, last - first)
    points = [
        {
            "x": round(_LEFT + _ACROSS * (each["step"] - first) / across, 1),
            "y": round(_FLOOR - _UP * each["success"], 1),
            "low": round(_FLOOR - _UP * each["low"], 1),
            "high": round(_FLOOR - _UP * each["high"], 1),
            "verdict": each["verdict"],
            "is_best": each["step"] == best,
        }
        for each in used
    ]
    return render(
        "training.html.j2",
        training=title,
        suite=suite,
        checkpoints=checkpoints,
        points=points,
        first=first,
        last=last,
        best=best,
        confidence=confidence,
        obstacles=obstacles,
        scores=tuple(dict.fromkeys(name for each in checkpoints for name in each["scores"])),
    )


_LEFT, _ACROSS, _FLOOR, _UP = 48.0, 620.0, 220.0, 200.0
"""Of the drawing of a training: where its axes begin, and how long they are."""
