"""Multi-scene: how well does a student of many scenes do, round after round, in new ones?"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from nw_eval.learn.studies.config import MultiSceneConfig
from nw_eval.learn.studies.figures.bars import PARTS, draw_bars
from nw_eval.learn.studies.figures.paper import COLOURS, WIDTH, save
from nw_eval.learn.studies.plan import (
    Part,
    PlannedStudent,
    StudyScene,
    held_out,
    slug,
    student_of,
    trained_in,
)
from nw_eval.learn.studies.scores import Outcome, Score, score
from nw_eval.learn.studies.write import cell
from nw_eval.reporting.tables import Table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from nw_eval.learn.studies.config import StudyConfig

_ALL = "all tasks"
_TITLE = "Success of students of many scenes"


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
                title=_TITLE,
                columns=("task", "round", *(f"{part} scenes" for part in PARTS)),
                rows=tuple(rows),
                numbers=frozenset({"round"}),
                note="Mean success with scenes weighted equally, its 95 % interval, and trials.",
            ),
        )

    def draw(
        self, path: Path, students: Sequence[PlannedStudent], scores: Sequence[Score], /
    ) -> None:
        """Draw a panel for each task, a pair of bars for each round."""
        from matplotlib.figure import Figure
        from matplotlib.patches import Patch

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
        patches = [Patch(color=COLOURS[part], label=f"{part} scenes") for part in PARTS]
        figure.suptitle(f"{_TITLE}: mean and 95 % interval", fontsize="large")
        figure.legend(handles=patches, loc="outside lower center", ncols=2, frameon=False)
        save(figure, path)


def _names(student: PlannedStudent) -> list[str]:
    """Return the tasks of a student, and what all of them are called if there are several."""
    tasks = sorted({each.task for each in student.scenes})
    return [*tasks, _ALL] if len(tasks) > 1 else tasks


def _groups(student: PlannedStudent) -> list[tuple[str, Part, set[str]]]:
    return [
        (name, part, {each.name for each in _of(student, name, part)})
        for name in _names(student)
        for part in PARTS
    ]


def _of(student: PlannedStudent, name: str, part: Part) -> list[StudyScene]:
    return [each for each in student.scenes if each.part == part and name in {_ALL, each.task}]


def _group(name: str, part: Part) -> str:
    return f"{name}, {part}"


def _counted(student: PlannedStudent, name: str) -> str:
    counts = " and ".join(f"{len(_of(student, name, part))} {part}" for part in PARTS)
    return f"{name}: {counts} scenes"
