"""Configs of studies: refused with file and line, and settled so that they mean one thing."""

from pathlib import Path

import pytest

from nw_base.errors import IncomparableError, UsageError
from nw_learn.config import find_config, load_config
from nw_learn.studies.kinds import MultiScene, Observations, SingleScene
from nw_learn.studies.plan import (
    MultiSceneConfig,
    ObservationsConfig,
    SingleSceneConfig,
    StudyConfig,
    settled,
    slug,
)
from nw_learn.studies.study import StudyFolder

PRESETS = Path(__file__).parents[3] / "training" / "studies"
KINDS = {
    "single-scene": SingleSceneConfig,
    "multi-scene": MultiSceneConfig,
    "observations": ObservationsConfig,
}


def fault(path, kind=SingleSceneConfig):
    with pytest.raises(UsageError) as caught:
        load_config(path, kind)
    return str(caught.value).removeprefix(f"{path}:")


def test_an_unknown_key_is_refused_with_its_line_and_the_nearest_one(written, small):
    path = written(small.replace("  rounds: 1", "  round: 1"))
    assert fault(path) == "11:3: unknown key 'round'; did you mean 'rounds'?"


@pytest.mark.parametrize("key", ["name: me", "seed: 4", "scenes: [flat/meadow]", "nw-train: 1"])
def test_what_the_study_says_of_a_student_stands_in_no_recipe(written, small, key):
    path = written(small.replace("  device: cpu", f"  {key}"))
    name = key.partition(":")[0]
    assert fault(path) == (f"9:1: student: {name!r} is the study's to say; take it out of here")


def test_a_config_of_another_kind_is_named_as_such(written, small):
    assert "3:1: study: 'single-scene' is not one of them" in fault(
        written(small), MultiSceneConfig
    )


def test_nobody_is_trained_in_an_evaluation_scene(written, small):
    path = written(small.replace("hurdles/two_brick_dusk", "hurdles/three_low"))
    with pytest.raises(UsageError, match="hurdles/three_low is an evaluation scene"):
        SingleScene().students(settled(load_config(path, SingleSceneConfig)))


def test_nobody_is_evaluated_as_in_a_new_scene_where_somebody_was_trained(written, small):
    text = small.replace("single-scene", "multi-scene") + "held_out: [hurdles/one_low_*]\n"
    with pytest.raises(UsageError, match="trained in hurdles/one_low_carpet"):
        MultiScene().students(settled(load_config(written(text), MultiSceneConfig)))


def test_each_task_may_have_a_student_of_its_own_scenes(written, small):
    text = small.replace("single-scene", "multi-scene").replace(
        "hurdles/two_brick_dusk", "gaps/two_14in_corridor"
    )
    text += "held_out: [hurdles/three_low, gaps/two_12in_carpet]\nby_task: true\n"
    first, second = MultiScene().students(settled(load_config(written(text), MultiSceneConfig)))
    assert (first.name, first.config.scenes) == ("hurdles", ["hurdles/one_low_carpet"])
    assert [scene.name for scene in first.scenes] == ["hurdles/one_low_carpet", "hurdles/three_low"]
    assert [scene.part for scene in second.scenes] == ["training", "evaluation"]
    assert first.config.seed == 3


def test_a_saved_config_is_that_which_was_begun_and_no_other(written, small, tmp_path):
    config = settled(load_config(written(small), SingleSceneConfig))
    folder = StudyFolder(tmp_path / "study")
    folder.begin(config, SingleScene().students(config), "a suite\n")
    assert folder.saved(SingleSceneConfig, config).digest == config.digest
    with pytest.raises(UsageError, match="holds a study already"):
        folder.begin(config, (), "")
    other = settled(load_config(written(small.replace("seed: 3", "seed: 4")), SingleSceneConfig))
    with pytest.raises(IncomparableError, match="is of another config"):
        folder.saved(SingleSceneConfig, other)


def test_names_of_scenes_become_names_of_students():
    assert slug("hurdles/one_low_carpet") == "hurdles-one_low_carpet"
    assert slug("/A b/Ünder $x") == "a-b-nder-x"
    assert slug("///") == "scene"


def test_the_config_of_the_page_on_studies_is_one(written):
    page = (PRESETS.parents[1] / "docs" / "how-to" / "studies.md").read_text(encoding="utf-8")
    text = page.partition("```yaml mine.yaml\n")[2].partition("```")[0]
    config = settled(load_config(written(text), ObservationsConfig))
    assert [student.name for student in Observations().students(config)] == list(config.variants)


@pytest.mark.parametrize("kind", KINDS)
def test_presets_of_the_papers_size_have_its_trajectories_and_rollouts(kind):
    config = load_config(find_config(f"{kind}-paper", folder="studies"), KINDS[kind])
    assert (config.student.trajectories, config.student.rounds) == (1000, 4)
    assert config.evaluation.trials == 50


@pytest.mark.parametrize("kind", KINDS)
def test_reduced_presets_take_under_an_hour_by_their_own_reckoning(kind):
    """90 trajectories or trials a minute and 2,000 samples a second, as their comments say."""
    config = settled(load_config(PRESETS / f"{kind}-reduced.yaml", KINDS[kind]))
    assert estimated_minutes(config) < 60.0


def estimated_minutes(config: StudyConfig) -> float:
    students, evaluations = {
        "single-scene": lambda c: (len(c.scenes), 1),
        "multi-scene": lambda c: (1, c.student.rounds),
        "observations": lambda c: (len(c.variants), 1),
    }[config.study](config)
    scenes = len(config.scenes) + len(getattr(config, "held_out", ()))
    rollouts = config.student.trajectories * config.student.rounds
    rollouts += scenes * config.evaluation.trials * evaluations
    return students * (rollouts / 90.0 + config.student.budget.steps / 2000.0 / 60.0)
