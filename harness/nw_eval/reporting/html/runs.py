"""A page over many runs: an index of them.

It shows what each run came to, how each policy's success went over training steps or dates,
and how every scene went from run to run. Any two of its runs can be put side by side there.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import urlsplit

from nw_base.plural import plural
from nw_eval.reporting.headline import headline_parts, part_of_suite
from nw_eval.reporting.html.environment import render
from nw_eval.reporting.html.limits import LadderLimit, bounds_words, limits_table
from nw_eval.reporting.tables.table import Bar
from nw_gate.limits.limit import Limit
from nw_gate.results.labels import links_of
from nw_gate.results.provenance import RunInfo
from nw_gate.stats.interval import Interval
from nw_gate.verdict import Verdict

_WIDTH, _HEIGHT = 120.0, 28.0
"""Of a trend's drawing."""
_LEVELS = (0.0, 0.1, 0.25, 0.5, 0.75)
"""Shares of success lost over which a cell is drawn one step stronger."""
_DIGITS = 10
"""Of a commit, shown."""
_KNOWN_SERVERS = frozenset({"", "github.com", "gitlab.com"})
_LABELS = (("commit", "commit"), ("branch", "branch"), ("pull_request", "pull"), ("job", "job"))
"""Columns of the page, where runs have such a label."""
_GIVEN = re.compile(r".*-[0-9]{8}T[0-9]{6}Z-[0-9a-f]{8}(?:-[0-9]+)?(?:-[0-9]+of[0-9]+)?", re.DOTALL)
"""A folder's name that no user chose: `nw_gate.results.run_folder`."""
_USUAL_SHARE = 0.5
"""Of trials that a cleared rung has at least, where nothing else is asked for."""
_NO_PICTURES: Mapping[tuple[str, str], bytes] = MappingProxyType({})


@dataclass(frozen=True, kw_only=True)
class LabelLink:
    """What a label says, and where it leads.

    Attributes:
        text: to show; it may be a third party's.
        href: an https address of the job's own server; empty where there is none.
        host: that server, where readers may not expect it.
    """

    text: str
    href: str
    host: str = ""


@dataclass(frozen=True, kw_only=True)
class ListedRun:
    """One run of the page."""

    folder: str
    """As one would type it."""
    href: str | None
    """Of its own page, relative to this one; None without a page."""
    info: RunInfo
    verdict: Verdict
    number: int = 0
    """On a page, the oldest is 1."""

    @property
    def suite(self) -> str:
        """The suite's name."""
        return str(self.info.suite.get("name", "suite"))

    @property
    def policy(self) -> str:
        """The policy's name, and of which training it is, where a label says so."""
        training = self.info.labels.get("training_run", "")
        name = self.info.policy.folder_name
        return f"{name} ({training})" if training and training != name else name

    @property
    def digest(self) -> str:
        """Of the policy's card and checkpoint."""
        return self.info.policy.short_digest

    @property
    def step(self) -> int | None:
        """The training step, where a label says it."""
        text = self.info.labels.get("step", "")
        return int(text) if re.fullmatch(r"[0-9]{1,15}", text) else None

    @property
    def when(self) -> datetime | None:
        """When it started; None if that is no time of these centuries."""
        try:
            found = datetime.fromisoformat(self.info.started)
        except ValueError:
            return None
        if not 1970 < found.year < 2200:
            return None
        return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)

    @property
    def date(self) -> str:
        """When it started, as a table shows it."""
        return self.info.started if self.when is None else f"{self.when:%Y-%m-%d %H:%M}"

    @property
    def name(self) -> str:
        """Its folder's name, if somebody gave it one of its own; else when it started."""
        says_more = self.info.id != self.info.policy.folder_name and not _GIVEN.fullmatch(
            self.info.id
        )
        return self.info.id if says_more else self.date

    @property
    def at(self) -> str:
        """What tells it from other runs of its policy: its training step, or else its name."""
        return self.name if self.step is None else f"step {self.step}"

    @property
    def links(self) -> dict[str, LabelLink]:
        """What its labels say of commit, branch, pull request and job, with where they lead."""
        labels, found = self.info.labels, links_of(self.info.labels)
        server = urlsplit(found.get("job_url", "")).netloc
        job = labels.get("job") or ("job" if "job_url" in labels else "")
        commit, pull = labels.get("commit", ""), labels.get("pull_request", "")
        shown = {
            "commit": LabelLink(text=commit[:_DIGITS], href=found.get("commit", "")),
            "branch": LabelLink(text=labels.get("branch", ""), href=found.get("branch", "")),
            "pull_request": LabelLink(text=pull and f"#{pull}", href=found.get("pull_request", "")),
            "job": LabelLink(
                text=job,
                href=found.get("job_url", ""),
                host="" if server in _KNOWN_SERVERS else server,
            ),
        }
        return {key: link for key, link in shown.items() if link.text}

    @property
    def order(self) -> tuple[Any, ...]:
        """By what runs are put in order of age; no two of a page have the same."""
        return self.info.started, self.info.id, self.folder

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
class ListedLimit:
    """A policy's limit on a ladder, as the page lists it."""

    run: ListedRun
    """Of its trials; `href` is that of the limits' page."""
    ladder: str
    title: str
    """What its rungs are, for people."""
    limit: Limit

    @property
    def result(self) -> Result | None:
        """Its point: at its training step where that is known, else at its date."""
        at = self.run.step if self.run.step is not None else self.run.when
        if at is None:
            return None
        low, high = (self.height(end) for end in self.limit.ends)
        return Result(
            at=float(at) if isinstance(at, int) else at.timestamp(),
            success=low,
            interval=Interval(low=low, high=high),
            name=f"{self.run.policy}, {self.run.at}",
            says=self.bounds,
        )

    @property
    def label(self) -> str:
        """The ladder, and what was asked on it where that is not the usual.

        Limits with one label share a column of a leaderboard and a line of a chart.
        """
        found = self.ladder
        if self.limit.share != _USUAL_SHARE:
            found += f", {100.0 * self.limit.share:g} % of trials"
        if not self.run.info.suite.get("episode", {}).get("contact_termination", True):
            found += ", with contacts"
        return found

    @property
    def bounds(self) -> str:
        """Its bounds in a few words."""
        return bounds_words(self.limit)

    @property
    def shown(self) -> LadderLimit:
        """As the limits' own page has it."""
        return LadderLimit(
            policy=self.run.policy,
            ladder=self.ladder,
            title=self.title,
            limit=self.limit,
            run=Path(self.run.folder),
        )

    def height(self, rung: int) -> float:
        """Return where a rung stands in a drawing, in [0, 1]."""
        return (rung + 1) / (len(self.limit.ladder.rungs) + 1)


@dataclass(frozen=True, kw_only=True)
class LadderTrend:
    """The limits on one ladder."""

    ladder: str
    title: str
    """What its rungs are, and in which unit."""
    charts: tuple[Chart, ...]
    """Over training steps, and over dates where these are not known."""


def _ladder_trends(limits: Sequence[ListedLimit]) -> list[LadderTrend]:
    """Return the limits of each ladder over training steps and dates, the latest policy first."""
    found: list[LadderTrend] = []
    for name in dict.fromkeys(each.label for each in limits):
        own = [each for each in limits if each.label == name]
        rungs = own[-1].limit.ladder.rungs
        ticks = (0, len(rungs) // 2, len(rungs) - 1)
        levels = [(_y(own[-1].height(rung)), f"{rungs[rung]:g}") for rung in ticks]
        charts: list[Chart] = []
        for axis, by_step in (("training step", True), ("date", False)):
            lines: dict[str, list[Result]] = {}
            for each in own[::-1]:
                if (each.run.step is not None) is by_step and each.result is not None:
                    lines.setdefault(each.run.policy, []).append(each.result)
            drawn = chart(axis, list(lines.items()))
            # Where no policy has two, there is nothing to see but the table.
            if drawn is not None and max(map(len, lines.values())) > 1:
                charts.append(replace(drawn, levels=tuple(levels)))
        unit = own[-1].limit.ladder.unit
        title = f"{own[-1].title}, {unit}" if unit else own[-1].title
        found.append(LadderTrend(ladder=name, title=title, charts=tuple(charts)))
    return found


@dataclass(frozen=True, kw_only=True)
class Trend:
    """Success from run to run: of a scene, or of all together."""

    name: str
    lines: tuple[tuple[float | None, ...], ...]
    """For each policy, in the order of its runs; None where a run has none."""

    @property
    def points(self) -> tuple[tuple[tuple[float, float], ...], ...]:
        """Of its drawing, those that there are, for each policy."""
        return tuple(
            tuple(
                (round(place * _WIDTH / max(1, len(line) - 1), 1), round(_HEIGHT * (1.0 - mean), 1))
                for place, mean in enumerate(line)
                if mean is not None
            )
            for line in self.lines
        )

    @property
    def levels(self) -> tuple[tuple[int, ...], ...]:
        """How strongly to draw each, from 0, all was reached, to 5."""
        return tuple(
            tuple(0 if mean is None else level_of(mean) for mean in line) for line in self.lines
        )

    @property
    def changes(self) -> tuple[float | None, ...]:
        """Of each policy the last run's success less that of the one before it, if it has two."""
        known = [[mean for mean in line if mean is not None] for line in self.lines]
        return tuple(line[-1] - line[-2] if len(line) > 1 else None for line in known)


@dataclass(frozen=True, kw_only=True)
class PolicyRuns:
    """The runs of one policy on one suite, by training step or the oldest first."""

    name: str
    runs: tuple[ListedRun, ...]

    @property
    def by_step(self) -> bool:
        """Whether all of them are of a training whose steps are known."""
        return all(run.step is not None for run in self.runs)

    @property
    def results(self) -> list[Result]:
        """Those that a drawing has room for."""
        found: list[Result] = []
        for run in self.runs:
            at = run.step if self.by_step else run.when and run.when.timestamp()
            if at is not None and run.verdict.success is not None:
                found.append(
                    Result(
                        at=float(at),
                        success=run.verdict.success,
                        interval=run.verdict.interval,
                        name=f"{self.name}, {run.at}",
                    )
                )
        return found


@dataclass(frozen=True, kw_only=True)
class SuiteTrends:
    """The runs of one suite, policy after policy."""

    suite: str
    policies: tuple[PolicyRuns, ...]
    """That with the latest run first."""
    trends: tuple[Trend, ...]
    """All scenes together first, then each in alphabetical order."""
    pictures: Mapping[str, bytes]
    """JPEGs by scene, as far as there are any."""

    @property
    def runs(self) -> tuple[ListedRun, ...]:
        """In the order of the policies."""
        return tuple(run for each in self.policies for run in each.runs)

    @property
    def charts(self) -> tuple[Chart, ...]:
        """Success over training steps, and over dates where these are not known."""
        drawn = (
            chart(
                axis,
                [(each.name, each.results) for each in self.policies if each.by_step is by_step],
            )
            for axis, by_step in (("training step", True), ("date", False))
        )
        return tuple(each for each in drawn if each is not None)

    @property
    def seed_sets(self) -> int:
        """How many seed sets the runs met; between two of these initial states differ too."""
        return len({(run.info.suite_digest, run.info.drawn_from) for run in self.runs})


def render_index(
    runs: Sequence[ListedRun],
    unread: Sequence[str],
    *,
    title: str = "",
    pictures: Mapping[tuple[str, str], bytes] = _NO_PICTURES,
    board: str = "",
    limits: Sequence[ListedLimit] = (),
) -> str:
    """Return the page.

    Args:
        runs: in any order.
        limits: of policies on ladders, in any order.
        unread: a sentence on each run that could not be read.
        title: above it; the number of runs if empty.
        pictures: JPEGs by name and digest of a scene.
        board: address of a leaderboard over the same runs; empty without one.
    """
    ordered = [
        replace(run, number=place)
        for place, run in enumerate(sorted(runs, key=lambda run: run.order), 1)
    ]
    suites = sorted({run.suite for run in ordered})
    found = sorted(limits, key=lambda each: (each.label, each.run.order))
    return render(
        "index.html.j2",
        title=title or plural(len(ordered), "run"),
        ladders=_ladder_trends(found),
        limits=[(each, limits_table([each.shown]).rows[0]) for each in found],
        runs=ordered[::-1],
        unread=tuple(unread),
        suites=[
            _trends(suite, [run for run in ordered if run.suite == suite], pictures)
            for suite in suites
        ],
        policies=sorted({run.policy for run in ordered}),
        verdicts=sorted({run.verdict.verdict for run in ordered}),
        labels=[(key, words) for key, words in _LABELS if any(key in run.links for run in ordered)],
        has_steps=any(run.step is not None for run in ordered),
        board=board,
    )


def _trends(
    suite: str, runs: Sequence[ListedRun], pictures: Mapping[tuple[str, str], bytes]
) -> SuiteTrends:
    """Return the trends of runs, the oldest first."""
    names = list(dict.fromkeys(run.policy for run in runs[::-1]))
    policies: list[PolicyRuns] = []
    for name in names:
        own = [run for run in runs if run.policy == name]
        if all(run.step is not None for run in own):
            own.sort(key=lambda run: (run.step, run.order))
        policies.append(PolicyRuns(name=name, runs=tuple(own)))
    means = [
        [{item.scene: item.mean for item in run.verdict.per_scene} for run in each.runs]
        for each in policies
    ]
    scenes = sorted({scene for line in means for each in line for scene in each})
    together = tuple(tuple(run.verdict.success for run in each.runs) for each in policies)
    digests = {(n, s.digest) for run in runs for n, s in run.info.scenes.items()}
    return SuiteTrends(
        suite=suite,
        policies=tuple(policies),
        trends=(
            Trend(name="all scenes", lines=together),
            *(
                Trend(
                    name=scene,
                    lines=tuple(tuple(each.get(scene) for each in line) for line in means),
                )
                for scene in scenes
            ),
        ),
        pictures={name: pictures[name, d] for name, d in sorted(digests) if (name, d) in pictures},
    )


def level_of(mean: float) -> int:
    """Return how strongly a cell of mean success is drawn: 0 where all was reached, to 5."""
    return sum(1.0 - mean > least for least in _LEVELS)


LEFT, RIGHT, TOP, FLOOR = 46.0, 560.0, 12.0, 232.0
"""Of the axes: names of lines stand to the right of them."""
STYLES = 6
"""Colours; the next lines have these again, dashed."""
MOST = 14
"""Lines of a drawing, which names have room beside."""
_NAME = 26  # characters of a name beside its line
_LINE = 15.0  # between two names
_TICKS = 5


@dataclass(frozen=True, kw_only=True)
class Result:
    """A run in a drawing.

    Attributes:
        at: the training step, or s since 1970.
        success: the mean, in [0, 1].
        interval: its bounds.
        name: of the run; it says the step of one.
        says: what it came to; its success if empty.
    """

    at: float
    success: float
    interval: Interval
    name: str
    says: str = ""


@dataclass(frozen=True, kw_only=True)
class DrawnResult:
    """A point, in units of the drawing."""

    x: float
    y: float
    low: float
    high: float
    says: str
    """Shown beside it when a pointer is over it."""


@dataclass(frozen=True, kw_only=True)
class DrawnLine:
    """A policy's results in order, and its name beside the last one."""

    name: str
    style: int
    """Which of the colours, from 0."""
    dashed: bool
    points: tuple[DrawnResult, ...]
    name_y: float


@dataclass(frozen=True, kw_only=True)
class Chart:
    """A drawing. `axis` says what goes to the right; `left_out` counts policies without room."""

    axis: str
    ticks: tuple[tuple[float, str], ...]
    lines: tuple[DrawnLine, ...]
    left_out: int
    levels: tuple[tuple[float, str], ...]
    """y and text of what goes upwards."""


def chart(axis: str, results: Sequence[tuple[str, Sequence[Result]]]) -> Chart | None:
    """Return the drawing of several policies' results; None without any.

    Args:
        axis: `training step` or `date`.
        results: names and results of policies, those first that are to be drawn if there are more
            than `MOST`.
    """
    kept = [(name, sorted(found, key=lambda each: each.at)) for name, found in results if found]
    if not kept:
        return None
    drawn = kept[:MOST]
    times = [each.at for _, found in drawn for each in found]
    first, last = min(times), max(times)

    def x(at: float) -> float:
        share = (at - first) / (last - first) if last > first else 0.5
        return round(LEFT + (RIGHT - LEFT) * share, 1)

    says = _date if axis == "date" else _nothing
    lines = [
        DrawnLine(
            name=name if len(name) <= _NAME else f"{name[: _NAME - 3]}...",
            style=place % STYLES,
            dashed=place >= STYLES,
            points=tuple(_point(each, x, says) for each in found),
            name_y=0.0,
        )
        for place, (name, found) in enumerate(drawn)
    ]
    marks = _steps(first, last) if axis == "training step" else _dates(first, last)
    return Chart(
        axis=axis,
        ticks=tuple((x(at), text) for at, text in marks),
        lines=tuple(_named(lines)),
        left_out=len(kept) - len(drawn),
        levels=tuple((_y(share / 100), f"{share} %") for share in (0, 25, 50, 75, 100)),
    )


def _point(each: Result, x: Callable[[float], float], says: Callable[[float], str]) -> DrawnResult:
    low, high = (_y(bound) for bound in (each.interval.low, each.interval.high))
    text = f"{each.name}{says(each.at)}: {each.says or f'success {each.success:.3f}'}"
    return DrawnResult(x=x(each.at), y=_y(each.success), low=low, high=high, says=text)


def _y(share: float) -> float:
    return round(FLOOR - (FLOOR - TOP) * share, 1)


def _named(lines: Sequence[DrawnLine]) -> list[DrawnLine]:
    """Return lines whose names stand as near to their last points as they do without touching."""
    order = sorted(range(len(lines)), key=lambda i: (lines[i].points[-1].y, i))
    heights = [lines[i].points[-1].y + 4.0 for i in order]
    for i in range(1, len(heights)):  # Downwards, then back up.
        heights[i] = max(heights[i], heights[i - 1] + _LINE)
    most = FLOOR + 8.0
    for i in range(len(heights) - 1, -1, -1):
        heights[i] = min(heights[i], most)
        most = heights[i] - _LINE
    at = dict(zip(order, heights, strict=True))
    return [replace(line, name_y=round(at[i], 1)) for i, line in enumerate(lines)]


def _steps(first: float, last: float) -> list[tuple[float, str]]:
    """Return round numbers from the first step to the last one, each with its text."""
    if last <= first:
        return [(first, f"{first:.0f}")]
    units = (factor * 10**k for k in range(16) for factor in (1, 2, 5))
    unit = next(unit for unit in units if (last - first) / unit <= _TICKS)
    least = -(-first // unit)
    found = [unit * (least + i) for i in range(int((last - least * unit) // unit) + 1)]
    return [(at, f"{at:.0f}") for at in found]


def _nothing(_: float) -> str:
    return ""


def _date(at: float) -> str:
    return f", {datetime.fromtimestamp(at, UTC):%Y-%m-%d %H:%M} UTC"


_MINUTE, _HOUR, _DAY = 60, 3600, 86400
_APART = (
    *(1, 2, 5, 10, 15, 30),
    *(_MINUTE * count for count in (1, 2, 5, 10, 15, 30)),
    *(_HOUR * count for count in (1, 2, 3, 6, 12)),
    *(_DAY * count for count in (1, 2, 4, 7, 14, 30, 60, 120, 365, 730, 1460, 3650)),
)
"""Seconds between two ticks."""


def _dates(first: float, last: float) -> list[tuple[float, str]]:
    """Return round times from the first to the last, each with its text; no two texts are alike."""
    if last <= first:
        return [(first, f"{datetime.fromtimestamp(first, UTC):%Y-%m-%d %H:%M}")]
    unit = next((each for each in _APART if (last - first) / each <= _TICKS), 10 * _APART[-1])
    form = "%Y-%m-%d" if unit >= _DAY else "%m-%d %H:%M" if unit >= _MINUTE else "%H:%M:%S"
    least = math.ceil(first / unit)
    found = [float(unit * at) for at in range(least, math.floor(last / unit) + 1)]
    # A moment between two of them has a tick of its own.
    return [(at, f"{datetime.fromtimestamp(at, UTC):{form}}") for at in found or [first]]
