"""A leaderboard: policies by suites and tasks, and every suite scene by scene; and badges.

A badge is a JSON of `https://shields.io/badges/endpoint-badge`, with the result of the latest run.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nw_base.clean import clean
from nw_eval.reporting.headline import part_of_suite, stopped_early
from nw_eval.reporting.html.environment import render
from nw_eval.reporting.html.runs import ListedLimit, ListedRun, level_of
from nw_eval.reporting.side_by_side import ranks_text
from nw_eval.reporting.tables.table import Bar
from nw_gate.results.provenance import RunInfo
from nw_gate.side_by_side import PolicyComparison
from nw_gate.stats.interval import Interval
from nw_gate.verdict import Verdict


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
    def name(self) -> str:
        """Its training step, or else its folder's name or when it started."""
        return ListedRun(folder="", href=None, info=self.info, verdict=self.verdict).at

    @property
    def stopped(self) -> str:
        """After how many trials it was stopped; nothing if it was not."""
        return stopped_early(self.info)

    @property
    def bar(self) -> Bar | None:
        """The drawing of its success by its verdict."""
        return ListedRun(folder="", href=None, info=self.info, verdict=self.verdict).bar

    @property
    def means(self) -> dict[str, float | None]:
        """Its success by scene."""
        return {item.scene: item.mean for item in self.verdict.per_scene}

    @property
    def identity(self) -> tuple[str, str]:
        """The policy: its name, and the digest of its card and checkpoint."""
        return self.info.policy.folder_name, self.info.policy.short_digest


@dataclass(frozen=True, kw_only=True)
class BoardSection:
    """Runs of one suite that compare with one another.

    Attributes:
        title: the suite's name, with a number where its runs do not all compare.
        note: why they do not; empty where they do.
        comparison: of their policies, in the order of `runs`.
        runs: one for each.
        stopped: runs that ended before they had met all scenes, and have no rank.
        pictures: JPEGs by scene, as far as there are any.
    """

    title: str
    note: str
    comparison: PolicyComparison
    runs: tuple[BoardRun, ...]
    stopped: tuple[BoardRun, ...] = ()
    pictures: Mapping[str, bytes]

    @property
    def order(self) -> list[int]:
        """Places of the policies, the best first."""
        policies = self.comparison.policies
        return sorted(range(len(policies)), key=lambda i: (-policies[i].mean, policies[i].label))

    @property
    def has_splits(self) -> bool:
        """Whether any of the policies says in which scenes it was trained."""
        runs = (*self.runs, *self.stopped)
        return any(each.split for run in runs for each in run.info.scenes.values())

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
        return level_of(mean)

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
    """A policy in one column: success, its interval, its ranks (of a task none), and its report.

    One that was stopped early has no rank.
    """

    mean: float
    interval: Interval
    rank: str
    href: str
    is_stopped: bool = False

    @property
    def order(self) -> tuple[bool, float]:
        """The best first, those without a rank last."""
        return self.is_stopped, -self.mean


@dataclass(frozen=True, kw_only=True)
class BoardLine:
    """A policy over all columns, those of ladders after those of suites.

    Attributes:
        name: of the policy.
        digest: of its card and checkpoint.
        run: the name or training step of its first run; empty where names tell all apart.
        standings: by column, None where it has no run.
    """

    name: str
    digest: str
    run: str
    standings: tuple[BoardStanding | None, ...]
    limits: tuple[ListedLimit | None, ...]
    """By ladder, the latest of each; None where it has none."""


def render_board(
    title: str,
    sections: Sequence[BoardSection],
    left_out: Sequence[str],
    *,
    runs_page: str = "",
    limits: Sequence[ListedLimit] = (),
) -> str:
    """Return the page.

    Args:
        title: above it.
        sections: in their order.
        limits: of policies on ladders, in any order.
        left_out: a sentence for each run that the page does not have.
        runs_page: address of an index of the runs; empty without one.
    """
    ladders = sorted({each.label for each in limits})
    columns, lines = _lines(sections, ladders, limits)
    return render(
        "site.html.j2",
        title=title,
        sections=tuple(sections),
        columns=columns,
        ladders=ladders,
        lines=lines,
        left_out=tuple(left_out),
        runs_page=runs_page,
        suites=len({section.comparison.suite for section in sections}),
        percent=f"{100 * sections[0].comparison.confidence:.4g} %" if sections else "",
    )


def _lines(
    sections: Sequence[BoardSection], ladders: Sequence[str], limits: Sequence[ListedLimit]
) -> tuple[list[str], list[BoardLine]]:
    """Return the names of the columns, and a line for each policy, the best of the first on top."""
    columns: list[str] = []
    standings: dict[tuple[str, str], dict[int, BoardStanding]] = {}
    called: dict[tuple[str, str], str] = {}
    for section in sections:
        tasks = section.comparison.tasks
        shown = [None, *tasks] if len(tasks) > 1 else [None]
        for task in shown:
            for place, (policy, run) in enumerate(
                zip(section.comparison.policies, section.runs, strict=True)
            ):
                found = policy if task is None else task.estimates[place]
                own = standings.setdefault(run.identity, {})
                called.setdefault(run.identity, run.name)
                # Of two runs of one policy in one suite, the first is the board's.
                own.setdefault(
                    len(columns),
                    BoardStanding(
                        mean=found.mean,
                        interval=found.interval,
                        rank=f"rank {section.rank(place)}"
                        if task is None and section.rank(place)
                        else "",
                        href=run.href,
                    ),
                )
            for run in section.stopped if task is None else ():
                called.setdefault(run.identity, run.name)
                standings.setdefault(run.identity, {}).setdefault(
                    len(columns),
                    BoardStanding(
                        mean=run.verdict.success or 0.0,
                        interval=run.verdict.interval,
                        rank="stopped early",
                        href=run.href,
                        is_stopped=True,
                    ),
                )
            columns.append(section.title if task is None else f"{section.title}: {task.task}")
    climbed: dict[tuple[str, str], dict[str, ListedLimit]] = {}
    for each in sorted(limits, key=lambda each: each.run.order):
        policy = each.run.info.policy
        key = (policy.folder_name, policy.short_digest)
        climbed.setdefault(key, {})[each.label] = each
        called.setdefault(key, each.run.at)
        standings.setdefault(key, {})
    names = [name for name, _ in standings]
    order = sorted(
        standings,
        key=lambda key: (
            [
                standings[key][c].order if c in standings[key] else (True, 1.0)
                for c in range(len(columns))
            ],
            key,
        ),
    )
    return columns, [
        BoardLine(
            name=name,
            digest=digest,
            run=called[name, digest] if names.count(name) > 1 else "",
            standings=tuple(standings[name, digest].get(c) for c in range(len(columns))),
            limits=tuple(climbed.get((name, digest), {}).get(ladder) for ladder in ladders),
        )
        for name, digest in order
    ]


_COLOURS = {
    "PASS": "brightgreen",
    "RAN": "blue",
    "INCONCLUSIVE": "yellow",
    "REGRESSED": "red",
    "INFRASTRUCTURE": "lightgrey",
    "INVALID": "lightgrey",
}
"""By the verdict's word, the best first: the badge of all suites has the colour of the worst."""


def badges(runs: Sequence[ListedRun], *, stem: str = "badge") -> dict[str, str]:
    """Return the text of each badge by the name of its file: `STEM.json`, `STEM-SUITE.json`.

    Args:
        runs: in any order; of each suite the latest one counts.
        stem: of the files' names.
    """
    latest = {run.suite: run for run in sorted(runs, key=lambda run: run.order)}
    found: dict[str, str] = {}
    for suite, run in sorted(latest.items()):
        slug = re.sub(r"[^A-Za-z0-9_.-]+", "-", suite)[:64]
        found.setdefault(f"{stem}-{slug}.json", _badge(suite, _words(run), run.verdict.verdict))
    words = [run.verdict.verdict for run in latest.values()]
    if not words:
        return {}
    if len(latest) == 1:
        message = _words(next(iter(latest.values())))
    else:
        counted = [(words.count(word), word) for word in _COLOURS if word in words]
        message = ", ".join(f"{count} {word}" for count, word in counted)
    worst = max(words, key=list(_COLOURS).index)
    return {f"{stem}.json": _badge("nw-eval", message, worst), **found}


def _words(run: ListedRun) -> str:
    success = run.verdict.success
    mean = "" if success is None else f" {success:.3f}"
    return f"{run.verdict.verdict}, {run.policy}{mean}"


def _badge(label: str, message: str, word: str) -> str:
    facts = {
        "schemaVersion": 1,
        "label": clean(label, at_most=64),
        "message": clean(message, at_most=120),
        "color": _COLOURS[word],
    }
    return f"{json.dumps(facts, indent=2)}\n"
