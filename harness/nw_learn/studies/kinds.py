"""The studies that there are: the policy each trains, what it computes, how it plots it.

* Single-scene: how well does a student of one scene do in each of the others?
* Multi-scene: how well does a student of many scenes do, round after round, in new ones?
* Observations: what of that which a student is given does it need?

Figures need no screen, and their colours differ for everybody.
"""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, Any, Protocol, get_args

import numpy as np

from nw_base.clean import clean
from nw_base.files.cache import atomic_path
from nw_base.plural import plural
from nw_eval.reporting.tables.table import Table
from nw_learn.studies.plan import (
    MultiSceneConfig,
    ObservationsConfig,
    Part,
    PlannedStudent,
    SingleSceneConfig,
    StudyScene,
    held_out,
    slug,
    student_of,
    trained_in,
)
from nw_learn.studies.scores import Outcome, Score, cell, difference, score

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from nw_learn.student.config import Sees
    from nw_learn.studies.plan import StudyConfig
    from nw_learn.studies.scores import Score

_BAR = 0.36
_UNSEEN = 0.01
"""A bar of less height is drawn as a line."""
_OVER_A_LINE = {"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8}
PARTS: tuple[Part, ...] = get_args(Part)

_CELL = 0.88
"""inches; a cell's numbers take three quarters of it."""
_NAMES = 1.7
_DARK = 0.5
"""Below this success a cell is dark and its numbers white."""

COLOURS: dict[Part, str] = {"training": "#0072B2", "evaluation": "#E69F00"}
"""Blue and orange of Okabe and Ito (2008), which people with any colour vision tell apart."""

WIDTH = 8.0
"""Of a figure, inches; 800 pixels."""

_LONGEST = 60


def _save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100, metadata={"Software": None})


def folded(name: str, width: int) -> str:
    """Return a name, such as a scene's, in lines of so many letters."""
    words = clean(name, at_most=_LONGEST).replace("/", " ").replace("_", " ")
    return textwrap.fill(words, width)


def draw_bars(
    axes: Axes,
    places: Sequence[str],
    scores: Mapping[tuple[int, Part], Score],
    *,
    is_difference: bool = False,
) -> None:
    """Draw a pair of bars at each position, or points where they are differences.

    Args:
        axes: to draw in.
        places: names from left to right.
        scores: by place and part; what is missing leaves a hole.
        is_difference: whether they go from -1 to 1 around a line at 0.
    """
    # Numbers shrink where bars are narrow, as far as one can read them at 800 pixels.
    size = 9 if len(places) <= 4 else 8
    for (place, part), shown in scores.items():
        if shown.estimate is None:
            continue
        at = place + (PARTS.index(part) - 0.5) * _BAR * 1.1
        low, high = shown.estimate.interval
        mean = shown.estimate.mean
        if is_difference:
            axes.plot(at, mean, "o", color=COLOURS[part], markersize=6)
        else:
            axes.bar(at, mean, _BAR, color=COLOURS[part])
            if mean < _UNSEEN:
                axes.hlines(mean, at - _BAR / 2, at + _BAR / 2, color=COLOURS[part], linewidth=4)
        axes.plot([at, at], [low, high], color="black", linewidth=1.3)
        axes.annotate(
            f"{mean:+z.2f}" if is_difference else f"{mean:.2f}",
            (at, high),
            (0, 2),
            textcoords="offset points",
            ha="center",
            fontsize=size,
            bbox=_OVER_A_LINE if is_difference else None,
        )
    axes.set_xticks(range(len(places)), places, parse_math=False)
    axes.set_xlim(-0.6, len(places) - 0.4)
    axes.tick_params(axis="x", length=0, labelsize=9)
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)
    if is_difference:
        axes.axhline(0.0, color="black", linewidth=0.8)
        axes.set_ylim(*_around(scores))
    else:
        axes.set_ylim(0.0, 1.12)
        axes.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0])


def save_bars(figure: Figure, path: Path, title: str) -> None:
    """Write a figure of bars with its title, and what the colours of its parts are.

    Raises:
        StoreError: it cannot be written.
    """
    from matplotlib.patches import Patch

    patches = [Patch(color=COLOURS[part], label=f"{part} scenes") for part in PARTS]
    figure.suptitle(f"{title}: mean and 95 % interval", fontsize="large")
    figure.legend(handles=patches, loc="outside lower center", ncols=2, frameon=False)
    _save(figure, path)


def _around(scores: Mapping[tuple[int, Part], Score]) -> tuple[float, float]:
    """Return what of -1 to 1 is to be seen, with room for the numbers above."""
    ends = [end for each in scores.values() if each.estimate for end in each.estimate.interval]
    most = max([0.1, *(abs(end) for end in ends)])
    return -1.1 * most, 1.3 * most


def draw_matrix(
    path: Path,
    rows: Sequence[str],
    columns: Sequence[str],
    cells: Mapping[tuple[int, int], Score],
    *,
    titles: tuple[str, str, str],
) -> None:
    """Draw mean success as a matrix.

    Args:
        path: of the PNG.
        rows: their names.
        columns: theirs.
        cells: scores by row and column; what is missing stays empty.
        titles: of the figure, its rows and its columns.

    Raises:
        StoreError: it cannot be written.
    """
    from matplotlib.figure import Figure

    wide = max(WIDTH, _NAMES + 1.0 + _CELL * len(columns))
    figure = Figure(figsize=(wide, 1.9 + 0.75 * len(rows)), layout="constrained")
    axes = figure.subplots()
    means = np.full((len(rows), len(columns)), np.nan)
    for place, cell_score in cells.items():
        means[place] = np.nan if cell_score.estimate is None else cell_score.estimate.mean
    shown = axes.imshow(means, cmap="cividis", vmin=0.0, vmax=1.0, aspect="auto")
    for place, cell_score in cells.items():
        _annotate(axes, place, cell_score)
    title, down, across = titles
    axes.set_title(title, parse_math=False, fontsize="medium")
    axes.set_yticks(range(len(rows)), [folded(name, 18) for name in rows], parse_math=False)
    names = [folded(name, 11) for name in columns]
    axes.set_xticks(range(len(columns)), names, parse_math=False)
    axes.tick_params(labelsize=9, length=0)
    axes.set_ylabel(down)
    axes.set_xlabel(across)
    figure.colorbar(shown, ax=axes, label="mean success", fraction=0.04, pad=0.02)
    _save(figure, path)


def _annotate(axes: Axes, place: tuple[int, int], score: Score) -> None:
    row, column = place
    estimate = score.estimate
    if estimate is None:
        axes.text(column, row, "no result", ha="center", va="center", fontsize=9)
        return
    colour = "white" if estimate.mean < _DARK else "black"
    low, high = estimate.interval
    axes.text(
        column,
        row - 0.12,
        f"{estimate.mean:.2f}",
        ha="center",
        va="center",
        color=colour,
        fontsize=13,
    )
    errors = f", {plural(score.errors, 'error')}" if score.errors else ""
    axes.text(
        column,
        row + 0.27,
        f"{low:.2f} to {high:.2f}\n{plural(estimate.n, 'trial')}{errors}",
        ha="center",
        va="center",
        color=colour,
        fontsize=8,
        linespacing=1.1,
    )


_SINGLE_SCENE = "Success of students of one scene in every scene"
_MULTI_SCENE = "Success of students of many scenes"
_OBSERVATIONS = "Success by what students are given"
_ALL = "all tasks"
_EQUAL = "Mean success with scenes weighted equally, its 95 % interval, and trials."
_BY_PART = tuple(f"{part} scenes" for part in PARTS)


class Kind(Protocol):
    """A kind of study: what it is asked."""

    @property
    def config(self) -> type[StudyConfig]:
        """The model of its configs."""
        ...

    def students(self, config: Any, /) -> tuple[PlannedStudent, ...]:
        """Return whom it trains.

        Raises:
            SceneError, UsageError: scenes cannot be used.
        """
        ...

    def scores(
        self, students: Sequence[PlannedStudent], outcomes: Sequence[Outcome], /
    ) -> list[Score]:
        """Return the numbers of its figure, as far as there are outcomes."""
        ...

    def tables(
        self, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> tuple[Table, ...]:
        """Return the same as tables."""
        ...

    def draw(
        self, path: Path, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> None:
        """Draw the figure.

        Raises:
            StoreError: it cannot be written.
        """
        ...


class SingleScene:
    """A student for each scene of a list, each evaluated in all of them."""

    config: type[StudyConfig] = SingleSceneConfig

    def students(self, config: SingleSceneConfig, /) -> tuple[PlannedStudent, ...]:
        """Return a student for each scene."""
        scenes = trained_in(config)
        names = [f"{index:02d}-{slug(each.name)}" for index, each in enumerate(scenes, 1)]
        return tuple(
            PlannedStudent(
                config=student_of(config, name, [scene]),
                scenes=scenes,
                rounds=(config.student.rounds,),
                label=scene.name,
            )
            for name, scene in zip(names, scenes, strict=True)
        )

    def scores(
        self, students: Sequence[PlannedStudent], outcomes: Sequence[Outcome], /
    ) -> list[Score]:
        """Return a score for each student and scene."""
        scores: list[Score] = []
        for student in students:
            for scene in student.scenes:
                mine = [
                    each
                    for each in outcomes
                    if each.student == student.name and each.scene == scene.name
                ]
                if mine:
                    last = student.rounds[-1]
                    scores.append(score(mine, student=student.name, number=last, group=scene.name))
        return scores

    def tables(
        self, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> tuple[Table, ...]:
        """Return the matrix as a table."""
        by_place = {(each.student, each.group): each for each in scores}
        scenes = [scene.name for scene in students[0].scenes]
        rows = [
            (each.label, *(cell(by_place.get((each.name, scene))) for scene in scenes))
            for each in students
        ]
        return (
            Table(
                title=_SINGLE_SCENE,
                columns=("trained in", *scenes),
                rows=tuple(rows),
                note="Mean success, its 95 % interval, and trials.",
            ),
        )

    def draw(
        self, path: Path, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> None:
        """Draw the matrix: rows are what students were trained in."""
        row = {each.name: index for index, each in enumerate(students)}
        column = {scene.name: index for index, scene in enumerate(students[0].scenes)}
        draw_matrix(
            path,
            [each.label for each in students],
            list(column),
            {(row[each.student], column[each.group]): each for each in scores},
            titles=(f"{_SINGLE_SCENE}: mean and 95 % interval", "trained in", "evaluated in"),
        )


class MultiScene:
    """One student of all training scenes, or of each task's; evaluated after each round."""

    config: type[StudyConfig] = MultiSceneConfig

    def students(self, config: MultiSceneConfig, /) -> tuple[PlannedStudent, ...]:
        """Return the student of all, or one for each task.

        Raises:
            UsageError: as `held_out`.
        """
        scenes = trained_in(config)
        new = held_out(config.held_out, scenes)
        groups = [("all", scenes)]
        if config.by_task:
            groups = [
                (task, tuple(each for each in scenes if each.task == task))
                for task in dict.fromkeys(each.task for each in scenes)
            ]
        return tuple(
            PlannedStudent(
                config=student_of(config, slug(name), mine),
                scenes=(*mine, *(each for each in new if name in {"all", each.task})),
                rounds=tuple(range(1, config.student.rounds + 1)),
                label=name,
            )
            for name, mine in groups
        )

    def scores(
        self, students: Sequence[PlannedStudent], outcomes: Sequence[Outcome], /
    ) -> list[Score]:
        """Return a score for each round, task and part; and of all tasks where one saw them all."""
        scores: list[Score] = []
        for student in students:
            for name, part, scenes in _groups(student):
                for number in student.rounds:
                    mine = [
                        each
                        for each in outcomes
                        if each.student == student.name
                        and each.round == number
                        and each.scene in scenes
                    ]
                    if mine:
                        group = _group(name, part)
                        scores.append(score(mine, student=student.name, number=number, group=group))
        return scores

    def tables(
        self, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> tuple[Table, ...]:
        """Return a row for each task and round."""
        by_place = {(each.student, each.group, each.round): each for each in scores}
        rows = [
            (
                name,
                str(number),
                *(cell(by_place.get((each.name, _group(name, part), number))) for part in PARTS),
            )
            for each in students
            for name in _names(each)
            for number in each.rounds
        ]
        return (
            Table(
                title=_MULTI_SCENE,
                columns=("task", "round", *_BY_PART),
                rows=tuple(rows),
                numbers=frozenset({"round"}),
                note=_EQUAL,
            ),
        )

    def draw(
        self, path: Path, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> None:
        """Draw a panel for each task, a pair of bars for each round."""
        from matplotlib.figure import Figure

        panels = [(student, name) for student in students for name in _names(student)]
        across = min(2, len(panels))
        down = math.ceil(len(panels) / across)
        figure = Figure(figsize=(WIDTH, 0.9 + 2.5 * down), layout="constrained")
        all_axes = figure.subplots(down, across, squeeze=False, sharey=True).flatten()
        for axes, (student, name) in zip(all_axes, panels, strict=False):
            wanted: dict[str, Part] = {_group(name, part): part for part in PARTS}
            draw_bars(
                axes,
                [str(number) for number in student.rounds],
                {
                    (each.round - 1, wanted[each.group]): each
                    for each in scores
                    if each.student == student.name and each.group in wanted
                },
            )
            axes.set_title(_counted(student, name), parse_math=False, fontsize="medium")
            axes.set_xlabel("DAgger round")
        for axes in all_axes[len(panels) :]:
            axes.remove()
        figure.supylabel("mean success")
        save_bars(figure, path, _MULTI_SCENE)


def _names(student: PlannedStudent) -> list[str]:
    """Return the tasks of a student, and what all of them are called if there are several."""
    tasks = sorted({each.task for each in student.scenes})
    return [*tasks, _ALL] if len(tasks) > 1 else tasks


def _groups(student: PlannedStudent) -> list[tuple[str, Part, set[str]]]:
    return [
        (name, part, {each.name for each in _scenes_of(student, name, part)})
        for name in _names(student)
        for part in PARTS
    ]


def _scenes_of(student: PlannedStudent, name: str, part: Part) -> list[StudyScene]:
    return [each for each in student.scenes if each.part == part and name in {_ALL, each.task}]


def _group(name: str, part: Part) -> str:
    return f"{name}, {part}"


def _counted(student: PlannedStudent, name: str) -> str:
    counts = " and ".join(f"{len(_scenes_of(student, name, part))} {part}" for part in PARTS)
    return f"{name}: {counts} scenes"


class Observations:
    """A student for each variant, all else being equal; all meet the same starts."""

    config: type[StudyConfig] = ObservationsConfig

    def students(self, config: ObservationsConfig, /) -> tuple[PlannedStudent, ...]:
        """Return a student for each variant.

        Raises:
            UsageError: as `held_out`.
        """
        scenes = trained_in(config)
        new = held_out(config.held_out, scenes)
        return tuple(
            PlannedStudent(
                config=student_of(config, name, scenes, sees=sees.model_dump(mode="json")),
                scenes=(*scenes, *new),
                rounds=(config.student.rounds,),
                label=name,
            )
            for name, sees in config.variants.items()
        )

    def scores(
        self, students: Sequence[PlannedStudent], outcomes: Sequence[Outcome], /
    ) -> list[Score]:
        """Return each student's scores, and then how they differ from the first student's."""
        scores: list[Score] = []
        for part in PARTS:
            first = _outcomes_in(outcomes, students[0], part)
            for student in students:
                mine = _outcomes_in(outcomes, student, part)
                if mine:
                    last = student.rounds[-1]
                    scores.append(score(mine, student=student.name, number=last, group=part))
                if mine and first and student is not students[0]:
                    scores.append(difference(mine, first, student=student.name, group=part))
        return scores

    def tables(
        self, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> tuple[Table, ...]:
        """Return the variants, and their differences from the first."""
        alone = {(each.student, each.group): each for each in scores if not each.against}
        paired = {(each.student, each.group): each for each in scores if each.against}
        return (
            Table(
                title=_OBSERVATIONS,
                columns=("student", "given", *_BY_PART),
                rows=tuple(
                    (
                        each.label,
                        inputs_in_words(each.config.sees),
                        *(cell(alone.get((each.name, part))) for part in PARTS),
                    )
                    for each in students
                ),
                note=_EQUAL,
            ),
            Table(
                title=f"Success less that of {students[0].label} on the same initial states",
                columns=("student", *_BY_PART),
                rows=tuple(
                    (each.label, *(cell(paired.get((each.name, part))) for part in PARTS))
                    for each in students[1:]
                ),
                note="Mean difference, its 95 % interval, and pairs of trials.",
            ),
        )

    def draw(
        self, path: Path, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> None:
        """Draw bars of all variants above, their differences from the first below."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(max(WIDTH, 1.2 + 1.35 * len(students)), 6.2), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
        place = {each.name: at for at, each in enumerate(students)}
        names = [
            f"{folded(each.label, 14)}\n({inputs_in_words(each.config.sees, separator=chr(10))})"
            for each in students
        ]
        for axes, is_difference in ((above, False), (below, True)):
            draw_bars(
                axes,
                names,
                {
                    (place[each.student], part): each
                    for each in scores
                    for part in PARTS
                    if each.group == part and bool(each.against) == is_difference
                },
                is_difference=is_difference,
            )
        above.set_ylabel("mean success")
        first = folded(students[0].label, 20)
        below.set_ylabel(f"success less that of\n{first}, same initial states", parse_math=False)
        save_bars(figure, path, _OBSERVATIONS)


def inputs_in_words(sees: Sees, separator: str = ", ") -> str:
    """Return what a student is given, in words."""
    words = [" + ".join(sees.cameras)]
    words += ["cones" if sees.cones else "no cones"]
    words += ["direction" if sees.direction else "no direction"]
    return separator.join(words)


def _outcomes_in(outcomes: Sequence[Outcome], student: PlannedStudent, part: Part) -> list[Outcome]:
    scenes = {each.name for each in student.scenes if each.part == part}
    return [each for each in outcomes if each.student == student.name and each.scene in scenes]
