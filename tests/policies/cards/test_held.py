"""Policies of some of a robot's joints: the card holds the others, and actions leave them out."""

from pathlib import Path

import numpy as np
import pytest

from nw_base.errors import PolicyError
from nw_policies.bundle import load_bundle
from nw_policies.cards import JointControl, actuator_values, load_card, motors_follow
from nw_policies.cards.terms import term_size
from nw_scenes.robots import get_robot

GO1 = get_robot("go1")
CARD = """\
nw-policy: 1
name: legs
robot: go1
adapter: zero
control:
  action: joint_position_offset
  scale: {0}
  {1}
  default_pose: {{hip: 0.05, thigh: 0.8, calf: -1.6}}
observations:
  obs:
    sensor: proprio
    terms:
      - joint_pos
      - {{term: joint_vel, leave_out: []}}
      - last_output
      - {{term: applied_action, leave_out: [hip]}}
"""


@pytest.fixture
def card_of(tmp_path):
    """Return a maker of cards that hold joints."""

    def card_of(held="held: {hip: 0.1}", scale="0.25"):
        path = tmp_path / "policy.yaml"
        path.write_text(CARD.format(scale, held))
        return load_card(path)

    return card_of


def places(name):
    return [i for i, joint in enumerate(GO1.joints) if name in joint]


def test_held_joints_stand_at_their_angles_whatever_the_action_is(card_of):
    control = JointControl.from_card(card_of(), GO1)
    assert len(control.driven) == 8
    targets = control.targets(control.whole(np.arange(1.0, 9.0)))
    assert targets[places("hip")] == pytest.approx([0.1] * 4)
    expected = np.where(np.arange(8) % 2, -1.6, 0.8) + 0.25 * np.arange(1.0, 9.0)
    others = [i for i in range(12) if i not in places("hip")]
    assert targets[others] == pytest.approx(expected)


def test_a_list_holds_joints_at_the_default_pose(card_of):
    control = JointControl.from_card(card_of("held: [hip, RL_calf]"), GO1)
    targets = control.targets(control.whole(np.ones(7)))
    assert targets[places("hip")] == pytest.approx([0.05] * 4)
    assert targets[places("RL_calf")] == pytest.approx([-1.6])
    assert targets[places("RR_calf")] == pytest.approx([-1.35])


def test_terms_have_no_numbers_of_held_joints_unless_they_leave_none_out(card_of):
    terms = card_of().observations["obs"].terms
    assert [term_size(term, GO1.joints) for term in terms] == [8, 12, 8, 8]


def test_held_joints_are_servos_beside_torques_of_the_policy(card_of):
    card = card_of().model_copy()
    card = card.model_copy(
        update={"control": card.control.model_copy(update={"action": "joint_torque"})}
    )
    follows = motors_follow(card, GO1)
    assert {follows[i] for i in places("hip")} == {"position"}
    assert {follows[i] for i in places("calf")} == {"torque"}
    assert actuator_values(card, GO1)["kd"][places("hip")] == pytest.approx(
        np.array(GO1.joint_damping)[places("hip")]
    )


@pytest.mark.parametrize(
    ("held", "scale", "words"),
    [
        ("held: [wing]", "0.25", "held: 'wing' names no joint"),
        ('held: ["*"]', "0.25", "every joint is held"),
        ("held: {hip: 3.0}", "0.25", "control.held: 3 is beyond the range"),
        ("held: [hip]", "[1, 1, 1]", "3 values for 8 joints"),
        ("held: [hip]", "{thigh: 1}", "no value for FR_calf"),
    ],
)
def test_what_cannot_be_held_is_refused_with_its_place(card_of, held, scale, words):
    with pytest.raises(PolicyError, match=words):
        card_of(held, scale)


def test_a_policy_of_fewer_joints_answers_as_many_numbers(card_of, tmp_path):
    card_of()
    assert load_bundle(str(tmp_path)).joints == 8


def test_cards_that_hold_nothing_are_what_they_were(card_of):
    assert "held" not in card_of("delay_steps: 0").model_dump()["control"]


def test_a_card_need_not_name_the_held_joints(card_of):
    legs = [name for name in GO1.joints if "hip" not in name][::-1]
    named = f"held: [hip]\n  joints: [{', '.join(legs)}]\n  kp: [1, 2, 3, 4, 5, 6, 7, 8]"
    card = card_of(named, "[1, 2, 3, 4, 5, 6, 7, 8]")
    control = JointControl.from_card(card, GO1)
    assert control.names[:8] == tuple(legs)
    targets = control.targets(control.whole(np.ones(8)))
    pose = [-1.6 if "calf" in name else 0.8 for name in legs]
    assert targets[control.order[:8]] == pytest.approx(np.array(pose) + np.arange(1.0, 9.0))
    gains = actuator_values(card, GO1)["kp"]
    assert gains[control.order[:8]].tolist() == [1, 2, 3, 4, 5, 6, 7, 8]
    assert gains[places("hip")].tolist() == np.array(GO1.kp)[places("hip")].tolist()


def test_a_checkpoint_of_fewer_joints_is_met_with_those_it_may_drive():
    from nw_policies.drafting.checkpoint import ArrayFacts, CheckpointFacts
    from nw_policies.drafting.exporters import ExporterMetadata
    from nw_policies.drafting.some_joints import driven_joints, held_lines, of_joints

    def gives(count):
        outputs = (ArrayFacts(name="actions", shape=(1, count), dtype="float32"),)
        return CheckpointFacts(path=tmp, format="onnx", adapter="onnx", sha256="", outputs=outputs)

    tmp = Path("policy.onnx")
    legs = tuple(joint for joint in GO1.joints if "hip" not in joint)
    named = ExporterMetadata(joint_names=legs[::-1])
    assert driven_joints(gives(8), named, GO1) == legs[::-1]
    assert driven_joints(gives(8), None, GO1) == GO1.joints[:8]  # All joints are of legs here.
    assert driven_joints(gives(12), None, GO1) == ()
    assert driven_joints(gives(3), None, GO1) == ()  # That is no walking robot.
    assert of_joints(GO1, legs).kp == tuple(np.array(GO1.kp)[[GO1.joints.index(j) for j in legs]])
    (line,) = held_lines(legs, GO1, named)
    assert line.startswith("  held: [FR_hip, FL_hip")
    assert "guessed" not in line
    assert "guessed" in held_lines(legs, GO1, None)[0]


def test_a_file_of_all_joints_says_how_the_others_are_held():
    from nw_policies.drafting.checkpoint import ExporterMetadata
    from nw_policies.drafting.some_joints import held_lines, known_of, known_of_all

    angles = tuple(n / 10 for n in range(12))
    known = ExporterMetadata(
        joint_names=GO1.joints, default_joint_pos=angles, joint_stiffness=(40.0,), joint_count=8
    )
    legs = tuple(joint for joint in GO1.joints if "hip" not in joint)
    part = known_of(known, legs)
    assert part.default_joint_pos == tuple(angles[GO1.joints.index(joint)] for joint in legs)
    assert part.joint_stiffness == (40.0,)
    (line,) = held_lines(legs, GO1, known)
    hips = [name.removesuffix("_joint") for name in GO1.joints if "hip" in name]
    assert line.startswith(f"  held: [{', '.join(hips)}]")
    assert "at the pose above" in line
    of_all = known_of_all(known, part, GO1)
    assert of_all is not None
    assert of_all.default_joint_pos == angles


@pytest.mark.parametrize(("outputs", "driven"), [(8, 8), (12, 0), (5, 0)])
def test_weights_of_a_training_say_how_many_joints_they_drive(tmp_path, outputs, driven):
    import torch

    from nw_policies.drafting.checkpoint import inspect_checkpoint
    from nw_policies.drafting.draft import write_card_draft
    from nw_policies.drafting.some_joints import driven_joints

    net = torch.nn.Sequential(torch.nn.Linear(39, 16), torch.nn.ELU(), torch.nn.Linear(16, outputs))
    weights = {f"actor.{name}": value for name, value in net.state_dict().items()}
    torch.save({"model_state_dict": {**weights, "std": torch.ones(outputs)}}, tmp_path / "model.pt")
    facts = inspect_checkpoint(tmp_path / "model.pt")
    assert len(driven_joints(facts, None, GO1)) == driven
    if driven:
        assert "  held: [" in write_card_draft(facts, GO1)
