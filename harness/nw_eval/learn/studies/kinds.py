"""The studies that there are: whom each trains, what it reckons, how it draws it.

* Single-scene: how well does a student of one scene do in each of the others?
* Multi-scene: how well does a student of many scenes do, round after round, in new ones?
* Observations: what of that which a student is given does it need?
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Protocol

from nw_eval.learn.studies.figures import (
    PARTS,
    WIDTH,
    draw_bars,
    draw_matrix,
    folded,
    save_bars,
)
from nw_eval.learn.studies.plan import (
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
from nw_eval.learn.studies.scores import Outcome, Score, cell, difference, score
from nw_eval.reporting.tables.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from nw_eval.learn.student.config import Sees
    from nw_eval.learn.studies.plan import StudyConfig

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
        names = [f"{place:02d}-{slug(each.name)}" for place, each in enumerate(scenes, 1)]
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
        found: list[Score] = []
        for student in students:
            for scene in student.scenes:
                mine = [
                    each
                    for each in outcomes
                    if each.student == student.name and each.scene == scene.name
                ]
                if mine:
                    last = student.rounds[-1]
                    found.append(score(mine, student=student.name, number=last, group=scene.name))
        return found

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
        row = {each.name: place for place, each in enumerate(students)}
        column = {scene.name: place for place, scene in enumerate(students[0].scenes)}
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
        found: list[Score] = []
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
                        found.append(score(mine, student=student.name, number=number, group=group))
        return found

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
        found: list[Score] = []
        for part in PARTS:
            first = _outcomes_in(outcomes, students[0], part)
            for student in students:
                mine = _outcomes_in(outcomes, student, part)
                if mine:
                    last = student.rounds[-1]
                    found.append(score(mine, student=student.name, number=last, group=part))
                if mine and first and student is not students[0]:
                    found.append(difference(mine, first, student=student.name, group=part))
        return found

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
                title=f"Success less that of {students[0].label} on the same starts",
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
        below.set_ylabel(f"success less that of\n{first}, same starts", parse_math=False)
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
