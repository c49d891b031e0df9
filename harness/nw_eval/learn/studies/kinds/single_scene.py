"""Single-scene: how well does a student of one scene do in each of the others?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.learn.studies.config import SingleSceneConfig
from nw_eval.learn.studies.figures.matrix import draw_matrix
from nw_eval.learn.studies.plan import PlannedStudent, slug, student_of, trained_in
from nw_eval.learn.studies.scores import Outcome, Score, score
from nw_eval.learn.studies.write import cell
from nw_eval.reporting.tables import Table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from nw_eval.learn.studies.config import StudyConfig

_TITLE = "Success of students of one scene in every scene"


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
                title=_TITLE,
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
            titles=(f"{_TITLE}: mean and 95 % interval", "trained in", "evaluated in"),
        )
