"""Numbers, tables and figures of studies, from trials whose outcome is invented."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from nw_gate.stats.bootstrap import mean_of_scenes
from nw_learn.config import load_config
from nw_learn.studies.kinds import MultiScene, Observations, SingleScene
from nw_learn.studies.plan import (
    MultiSceneConfig,
    ObservationsConfig,
    SingleSceneConfig,
    settled,
)
from nw_learn.studies.scores import Outcome, difference, score, write_page, write_scores


def trials(scene, successes, *, student="me", number=1):
    return [
        Outcome(student=student, round=number, scene=scene, trial=f"{scene}/{at}", success=value)
        for at, value in enumerate(successes)
    ]


def test_scenes_count_alike_and_errors_are_counted_apart():
    outcomes = [*trials("a", [1.0, 1.0, 0.0, 0.0]), *trials("b", [1.0, None, 1.0])]
    found = score(outcomes, student="me", number=2, group="both")
    assert found.estimate is not None
    # (2/4 + 2/2) / 2; the mean of trials would be 4/6.
    assert found.estimate.mean == 0.75
    assert (found.estimate.n, found.errors, found.round) == (6, 1, 2)
    alone = mean_of_scenes([np.array([1.0, 1.0, 0.0, 0.0]), np.ones(2)])
    assert found.estimate.interval == alone.interval


def test_without_any_result_there_is_no_number():
    found = score(trials("a", [None, None]), student="me", number=1, group="a")
    assert (found.estimate, found.errors) == (None, 2)


def test_differences_are_taken_start_by_start():
    """Starts differ by 1, students by a quarter on each: pairs see that, and nothing of starts."""
    easy_and_hard = [0.75, 0.0] * 10
    mine = trials("a", [value + 0.25 for value in easy_and_hard])
    theirs = trials("a", easy_and_hard, student="first")
    found = difference(mine, theirs, student="me", group="a")
    assert found.estimate is not None
    assert found.estimate.mean == pytest.approx(0.25)
    assert (found.estimate.n, found.against) == (20, "first")
    low, high = found.estimate.interval
    alone = score(mine, student="me", number=1, group="a").estimate
    assert alone is not None
    # Unpaired, a difference of two such means is wider than either of them.
    assert high - low < alone.interval.high - alone.interval.low
    assert 0.0 < low <= 0.25 <= high


def test_starts_that_one_of_two_has_no_result_from_are_left_out_of_their_difference():
    mine = trials("a", [1.0, None, 0.5])
    theirs = trials("a", [0.5, 0.0], student="first")
    found = difference(mine, theirs, student="me", group="a")
    assert found.estimate is not None
    assert (found.estimate.mean, found.estimate.n, found.errors) == (0.5, 1, 2)


def test_equal_students_differ_by_nothing_but_not_surely():
    outcomes = trials("a", [1.0, 0.5, 0.0, 1.0])
    found = difference(outcomes, outcomes, student="me", group="a").estimate
    assert found is not None
    assert found.mean == 0.0
    assert found.interval.low < 0.0 < found.interval.high


@pytest.fixture
def single(written, small):
    return SingleScene().students(settled(load_config(written(small), SingleSceneConfig)))


def test_a_matrix_has_a_row_for_each_student_and_a_column_for_each_scene(single, tmp_path):
    first, second = single
    at_home, away = "hurdles/one_low_carpet", "hurdles/two_brick_dusk"
    outcomes = [
        *trials(at_home, [1.0, 1.0], student=first.name),
        *trials(away, [0.5, 0.0], student=first.name),
        *trials(at_home, [0.0, None], student=second.name),
    ]
    kind = SingleScene()
    scores = kind.scores(single, outcomes)
    (table,) = kind.tables(single, scores)
    assert table.columns == ("trained in", at_home, away)
    assert [row[0] for row in table.rows] == [at_home, away]
    cells = [[cell.partition(" ")[0] for cell in row[1:]] for row in table.rows]
    assert cells == [["1.00", "0.25"], ["0.00", ""]]  # The last has not been evaluated.
    assert table.rows[1][1].endswith("), 1, 1 error")
    kind.draw(tmp_path / "figure.png", single, scores)
    assert Image.open(tmp_path / "figure.png").width == 800


def test_rounds_are_apart_and_so_are_tasks_and_scenes_that_are_new(written, small, tmp_path):
    text = small.replace("single-scene", "multi-scene").replace("rounds: 1", "rounds: 2")
    text = text.replace("hurdles/two_brick_dusk", "gaps/two_14in_corridor")
    text += "held_out: [hurdles/three_low]\n"
    kind = MultiScene()
    students = kind.students(settled(load_config(written(text), MultiSceneConfig)))
    outcomes = [
        *trials("hurdles/one_low_carpet", [1.0, 0.5], student="all"),
        *trials("gaps/two_14in_corridor", [0.0, 0.0], student="all"),
        *trials("hurdles/three_low", [0.5, 0.0], student="all"),
        *trials("hurdles/one_low_carpet", [1.0, 1.0], student="all", number=2),
    ]
    scores = kind.scores(students, outcomes)
    means = {(each.group, each.round): each.estimate.mean for each in scores}
    assert means == {
        ("gaps, training", 1): 0.0,
        ("hurdles, training", 1): 0.75,
        ("hurdles, training", 2): 1.0,
        ("hurdles, evaluation", 1): 0.25,
        ("all tasks, training", 1): 0.375,
        ("all tasks, training", 2): 1.0,
        ("all tasks, evaluation", 1): 0.25,
    }
    (table,) = kind.tables(students, scores)
    assert [row[:2] for row in table.rows][2:4] == [("hurdles", "1"), ("hurdles", "2")]
    kind.draw(tmp_path / "figure.png", students, scores)
    assert Image.open(tmp_path / "figure.png").width == 800


def test_what_students_are_given_is_compared_with_the_first_on_the_same_starts(
    written, small, tmp_path
):
    text = small.replace("single-scene", "observations")
    text = "\n".join(line for line in text.splitlines() if "sees:" not in line)
    text += "\nheld_out: [hurdles/three_low]\nvariants: {rgb: {}, blind-of-cones: {cones: false}}\n"
    kind = Observations()
    students = kind.students(settled(load_config(written(text), ObservationsConfig)))
    assert [student.config.sees.cones for student in students] == [True, False]
    outcomes = [
        *trials("hurdles/three_low", [1.0, 0.0], student="rgb"),
        *trials("hurdles/three_low", [0.5, 0.0], student="blind-of-cones"),
    ]
    scores = kind.scores(students, outcomes)
    found = [(each.student, each.group, each.against, each.estimate.mean) for each in scores]
    assert found == [
        ("rgb", "evaluation", "", 0.5),
        ("blind-of-cones", "evaluation", "", 0.25),
        ("blind-of-cones", "evaluation", "rgb", -0.25),
    ]
    alone, paired = kind.tables(students, scores)
    assert alone.rows[1][1] == "rgb, no cones, direction"
    assert paired.rows[0][2].startswith("-0.25 (-")
    write_page(tmp_path / "table.md", (alone, paired))
    assert (
        "## Success less that of rgb on the same initial states"
        in (tmp_path / "table.md").read_text()
    )
    kind.draw(tmp_path / "figure.png", students, scores)
    assert Image.open(tmp_path / "figure.png").width == 800


def test_the_numbers_of_a_figure_are_a_table_for_programs(tmp_path):
    scores = [
        score(trials("a", [1.0, 0.5]), student="me", number=1, group="a"),
        score(trials("b", [None]), student="me", number=1, group="b"),
    ]
    write_scores(tmp_path / "table.parquet", scores)
    rows = pq.read_table(tmp_path / "table.parquet").to_pylist()
    assert [(row["group"], row["success"], row["trials"], row["errors"]) for row in rows] == [
        ("a", 0.75, 2, 0),
        ("b", None, 0, 1),
    ]
    assert rows[0]["low"] < 0.75 < rows[0]["high"]
