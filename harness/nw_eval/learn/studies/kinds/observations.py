"""Observations: what of that which a student is given does it need?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.learn.studies.config import ObservationsConfig
from nw_eval.learn.studies.figures.bars import PARTS, draw_bars
from nw_eval.learn.studies.figures.paper import COLOURS, WIDTH, folded, save
from nw_eval.learn.studies.plan import Part, PlannedStudent, held_out, student_of, trained_in
from nw_eval.learn.studies.scores import Outcome, Score, difference, score
from nw_eval.learn.studies.write import cell
from nw_eval.reporting.tables import Table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from nw_eval.learn.student.config import Sees
    from nw_eval.learn.studies.config import StudyConfig

_TITLE = "Success by what students are given"


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
            first = _of(outcomes, students[0], part)
            for student in students:
                mine = _of(outcomes, student, part)
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
        columns = tuple(f"{part} scenes" for part in PARTS)
        return (
            Table(
                title=_TITLE,
                columns=("student", "given", *columns),
                rows=tuple(
                    (
                        each.label,
                        inputs_in_words(each.config.sees),
                        *(cell(alone.get((each.name, part))) for part in PARTS),
                    )
                    for each in students
                ),
                note="Mean success with scenes weighted equally, its 95 % interval, and trials.",
            ),
            Table(
                title=f"Success less that of {students[0].label} on the same starts",
                columns=("student", *columns),
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
        from matplotlib.patches import Patch

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
        patches = [Patch(color=COLOURS[part], label=f"{part} scenes") for part in PARTS]
        figure.suptitle(f"{_TITLE}: mean and 95 % interval", fontsize="large")
        figure.legend(handles=patches, loc="outside lower center", ncols=2, frameon=False)
        save(figure, path)


def inputs_in_words(sees: Sees, separator: str = ", ") -> str:
    """Return what a student is given, in words."""
    words = [" + ".join(sees.cameras)]
    words += ["cones" if sees.cones else "no cones"]
    words += ["direction" if sees.direction else "no direction"]
    return separator.join(words)


def _of(outcomes: Sequence[Outcome], student: PlannedStudent, part: Part) -> list[Outcome]:
    scenes = {each.name for each in student.scenes if each.part == part}
    return [each for each in outcomes if each.student == student.name and each.scene in scenes]
