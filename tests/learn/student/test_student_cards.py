"""What a student's card says: the teacher's motors, and what the config lets it see."""

from pathlib import Path

import pytest
from student_parts import small_config

from nw_base.errors import UsageError
from nw_eval.engine.provenance import split_for
from nw_learn.config import load_config
from nw_learn.student.card import check_teacher, student_card
from nw_learn.student.config import NOTHING, StudentConfig
from nw_learn.student.driving import training_scenes
from nw_learn.student.network import StudentNetwork, write_policy
from nw_learn.student.train import body_size
from nw_policies import load_bundle
from nw_policies.cards.load import card_of
from nw_sim.catalogue import FoundScene, names
from nw_sim.rollout.confined.vetting import check_bundle
from nw_sim.sensors import check_card

DIGESTS = {"policy.onnx": "0" * 64, "encoder.onnx": "0" * 64}
TRAINING = Path(__file__).parents[3] / "training"


def shapes(teacher, **sees):
    config = small_config(sees=sees)
    card = card_of(student_card("pupil", config.sees, teacher.card, sha256=DIGESTS))
    return card, {spec.name: spec.shape for spec in check_card(card)}


def test_a_student_has_the_motors_and_the_command_of_its_teacher(teacher):
    card, _ = shapes(teacher)
    assert card.control == teacher.card.control
    assert card.command == teacher.card.command
    assert card.robot == teacher.card.robot


def test_a_student_sees_as_many_images_as_its_config_says(teacher):
    assert shapes(teacher, frames=3)[1]["rgb"] == (9, 45, 80)
    assert shapes(teacher, frames=1)[1]["rgb"] == (3, 45, 80)
    both = shapes(teacher, depth=True, frames=4)[1]
    assert (both["rgb"], both["depth"]) == ((12, 45, 80), (4, 45, 80))
    alone = shapes(teacher, rgb=False, depth=True, frames=1)[1]
    assert alone["depth"] == (1, 45, 80)
    assert "rgb" not in alone


def test_a_student_that_is_not_told_the_direction_has_one_number_less(teacher):
    told, untold = (shapes(teacher, direction=way)[1] for way in (True, False))
    assert told["proprio"] == (46,)
    assert untold["proprio"] == (45,)
    assert told["history"] == untold["history"]


@pytest.mark.parametrize("cones", [True, False])
def test_cones_stand_in_all_images_or_in_none(teacher, cones):
    card, _ = shapes(teacher, depth=True, cones=cones)
    assert [card.observations[name].cones for name in ("rgb", "depth")] == [cones, cones]


def test_a_student_with_the_mean_image_for_good_asks_for_no_image(teacher):
    sees = small_config(sees={"depth": True}).sees
    blind = student_card("pupil", sees, teacher.card, sha256=DIGESTS, is_blind=True)
    card = card_of(blind)
    assert not card.splat_images
    assert set(card.observations) == {"proprio", "last_output", "history", "past"}


def test_a_teacher_that_acts_too_rarely_is_refused(teacher):
    control = teacher.card.control.model_copy(update={"rate": 25})
    with pytest.raises(UsageError, match="acts 25 times a second"):
        check_teacher(teacher.card.model_copy(update={"control": control}))


def test_a_student_that_sees_nothing_is_none():
    with pytest.raises(ValueError, match="sees nothing"):
        small_config(sees={"rgb": False})


@pytest.mark.parametrize(
    "preset",
    [
        "student-rgb",
        "student-rgb-further",
        "student-rgb-ray",
        "student-rgb-ray-further",
        "student-depth",
        "student-rgb-small",
    ],
)
def test_the_configs_that_are_shipped_can_be_trained(preset, teacher):
    config = load_config(TRAINING / f"{preset}.yaml", StudentConfig)
    assert config.teacher == teacher.name
    assert body_size(config, teacher) == 337
    assert config.trajectories % len(training_scenes(config.scenes)) == 0
    assert config.start == NOTHING or (config.base / config.start).is_file()


@pytest.mark.parametrize("preset", ["student-rgb", "student-rgb-ray", "student-depth-further"])
def test_evaluation_scenes_are_held_out_by_the_card_of_a_student(preset, teacher):
    scenes = load_config(TRAINING / f"{preset}.yaml", StudentConfig).scenes
    written = student_card(
        "pupil", small_config().sees, teacher.card, sha256=DIGESTS, scenes=scenes
    )
    card = card_of(written)
    assert card.trained_on[: len(scenes)] == tuple(scenes)
    told = {name: split_for(card, FoundScene.at(name)) for name in names()}
    driven = {each.scene.name.partition("~")[0] for each in training_scenes(scenes)}
    assert driven == {name for name, split in told.items() if split == "train"}
    assert set(names("eval")) == {name for name, split in told.items() if split == "eval"}


def test_a_students_card_names_no_folders_and_no_scenes_that_were_left_out(teacher):
    sees = small_config().sees
    for scenes, said in {
        ("split:train", "split:eval", "mine/hall"): ["split:train"],
        ("gaps/three_16in_hall", "flat/*"): ["flat/*"],
        ("stairs/*~2",): ["stairs/*~2", "!split:eval"],
        ("mine/hall",): None,
    }.items():
        card = student_card("pupil", sees, teacher.card, sha256=DIGESTS, scenes=scenes)
        assert card.get("trained_on") == said


@pytest.mark.parametrize("eyes", [{"rgb": True}, {"rgb": False, "depth": True}, {"depth": True}])
def test_a_students_network_takes_what_its_card_gives(eyes, teacher, tmp_path):
    config = small_config(sees={"width": 16, "height": 16, "frames": 2} | eyes)
    network = StudentNetwork(config.network, config.sees, proprio=body_size(config, teacher))
    write_policy(tmp_path, network, config, teacher.card)
    written = load_bundle(tmp_path)
    assert written.checkpoint.stat().st_size < 4_000_000
    assert {spec.name for spec in check_bundle(written)} >= {name for name in eyes if eyes[name]}
