"""`control.motors` of cards: what is refused, where, and whose identity the files are part of."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from nw_base.errors import PolicyError
from nw_eval import api
from nw_policies import load_bundle
from nw_policies.cards import Card, load_card, motor_groups
from nw_scenes.robots import get_robot
from nw_sim.physics import Actuators
from nw_sim.probe.recording import record
from nw_sim.rollout.driven import driven, programs_of

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
GO1 = get_robot("go1")
HEAD = (
    "nw-policy: 1\nname: m\nrobot: go1\nadapter: zero\ncontrol:\n  action: joint_position_offset\n"
)
NETWORK = "kind: network, file: motor.pt, history: [0, 1, 2]"


def write(folder, motors, head=HEAD):
    folder.mkdir(exist_ok=True)
    (folder / "policy.yaml").write_text(f"{head}  motors: {motors}\n")
    return folder / "policy.yaml"


def network(path, size=6):
    module = nn.Sequential(nn.Linear(size, 4), nn.Tanh(), nn.Linear(4, 1)).eval()
    torch.jit.script(module).save(str(path))
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("motors", "said"),
    [
        ("[{kind: pd, joints: elbow}]", "control.motors: 'elbow' of group 0 names no joint"),
        (
            "[{kind: pd, joints: hip}, {kind: pd, joints: 'FR_*'}]",
            "control.motors: FR_hip is in the groups 0 and 1",
        ),
        ("[]", "control.motors: is empty"),
        ("[{kind: pid}]", "pid"),
        ("[{joints: hip}]", "kind"),
        ("[{kind: dc, saturation_torque: 20}]", "no_load_speed"),
        ("[{kind: dc, saturation_torque: 0, no_load_speed: 20}]", "must be more than 0"),
        ("[{kind: dc, saturation_torque: .inf, no_load_speed: 20}]", "finite"),
        ("[{kind: pd, saturation_torque: 20}]", "saturation_torque"),
        ("[{kind: pd, delay: -1}]", "must be at least 0"),
        ("[{kind: pd, delay: 101}]", "must be at most 100"),
        ("[{kind: pd, delay: 1.5}]", "1.5"),
        ("[{kind: pd, response: {time_constant: 0}}]", "time_constant"),
        ("[{kind: pd, response: {frequency: 8}}]", "damping"),
        ("[{kind: network}]", "file"),
        ("[{kind: network, file: ../motor.pt}]", "leaves the card's folder"),
        ("[{kind: network, file: m.pt, history: []}]", "history: is empty"),
        ("[{kind: network, file: m.pt, order: pos}]", "did you mean"),
        (
            "[{kind: network, file: m.pt, saturation_torque: 9}]",
            "a curve needs `saturation_torque` and `no_load_speed`",
        ),
    ],
)
def test_what_is_wrong_with_motors_is_said_with_its_line(motors, said, tmp_path):
    with pytest.raises(PolicyError) as caught:
        load_card(write(tmp_path / "m", motors))
    assert "policy.yaml:7:" in str(caught.value)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (NETWORK, "the network of motors is missing"),
        (f"{NETWORK}, sha256: {'a' * 64}", "is missing"),
        (f"{NETWORK.replace('motor', 'other')}, sha256: {'a' * 64}", "SHA-256 is"),
    ],
)
def test_a_network_that_is_not_there_is_refused(keys, said, tmp_path):
    card = write(tmp_path / "m", f"[{{{keys}}}]")
    network(tmp_path / "m" / "other.pt")
    with pytest.raises(PolicyError) as caught:
        load_bundle(card)
    assert said in str(caught.value)
    assert "--checkpoint" not in str(caught.value), "which is the policy's own"


def test_a_network_of_another_size_is_refused_before_the_first_step(tmp_path):
    card = write(tmp_path / "m", f"[{{{NETWORK}}}]")
    network(tmp_path / "m" / "motor.pt", size=4)
    with pytest.raises(PolicyError, match="takes 4 numbers a joint, the card gives it 6"):
        record(load_bundle(card), scene="flat/carpet_room", seconds=0.1)


SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: {policy}
trials: 1
seed: 5
scenes: [flat/carpet_room]
"""


@pytest.mark.parametrize(
    ("size", "said"),
    [
        (4, "takes 4 numbers a joint, the card gives it 6"),
        (0, "no network of a motor that is known here"),
        (6, None),
    ],
)
def test_a_suites_check_reads_the_networks_of_motors(size, said, tmp_path):
    write(tmp_path / "m", f"[{{{NETWORK}}}]")
    file = tmp_path / "m" / "motor.pt"
    if size:
        network(file, size=size)
    else:
        torch.jit.script(nn.Conv1d(6, 1, 1)).save(str(file))
    (tmp_path / "suite.yaml").write_text(SUITE.format(policy=tmp_path / "m"))
    if said is None:
        assert api.plan(str(tmp_path / "suite.yaml"))
        return
    with pytest.raises(PolicyError) as caught:
        api.plan(str(tmp_path / "suite.yaml"))
    assert said in str(caught.value)
    assert "motor.pt" in str(caught.value)


def test_a_network_drives_no_joint_that_is_told_torques(tmp_path):
    head = HEAD.replace(
        "joint_position_offset", "{hip: joint_torque, thigh: joint_position, calf: joint_position}"
    )
    network(tmp_path / "motor.pt")
    card = load_card(write(tmp_path, f"[{{{NETWORK}}}]", head))
    with pytest.raises(PolicyError, match="FR_hip is told another thing"):
        motor_groups(card, GO1)
    own = load_card(write(tmp_path, f"[{{joints: [thigh, calf], {NETWORK}}}]", head))
    ((_, places),) = motor_groups(own, GO1)
    assert len(places) == 8


def test_groups_become_drives_of_their_joints(tmp_path):
    motors = (
        f"[{{joints: hip, {NETWORK}}}, {{joints: calf, kind: dc, saturation_torque: 40,"
        " no_load_speed: 20, delay: 2}]"
    )
    card = write(tmp_path, motors)
    network(tmp_path / "motor.pt")
    bundle = load_bundle(card)
    found = driven(Actuators.of(GO1), bundle.card, GO1, programs_of(bundle))
    assert [drive.joints.tolist() for drive in found.drives] == [[0, 3, 6, 9], [2, 5, 8, 11]]
    assert found.drives[0].program.inputs["x"].shape == (4, 6)
    assert found.drives[1].program is None
    assert found.driven.tolist() == [True, False, True] * 4


def test_the_network_counts_for_who_the_policy_is_and_its_place_does_not(tmp_path):
    digests = []
    for number, (name, seed) in enumerate((("motor", 0), ("other", 0), ("motor", 1))):
        torch.manual_seed(seed)
        folder = tmp_path / str(number)
        card = write(folder, f"[{{{NETWORK.replace('motor', name)}}}]")
        network(folder / f"{name}.pt")
        bundle = load_bundle(card)
        assert bundle.files[-1].name == f"{name}.pt"
        digests.append((bundle.digest, bundle.computes))
    assert len(set(digests)) == 3 or digests[0] == digests[1], "torch may write other bytes"
    assert digests[0] != digests[2]


def test_a_card_without_motors_keeps_its_fields():
    """So it keeps its digest: `bundle.digest` is of them."""
    card = Card.model_validate(
        {
            "nw-policy": 1,
            "name": "c",
            "robot": "go1",
            "adapter": "zero",
            "control": {"action": "joint_position_offset"},
        }
    )
    fields = card.model_dump(mode="json")["control"]
    assert not {"motors", "viscous_friction", "held"} & set(fields)


@pytest.fixture(scope="module")
def walked():
    """A function: the shipped policy on flat ground for two seconds, with groups of motors."""
    bundle = load_bundle("go1-parkour")

    def walked(*motors, **keys):
        fields = bundle.card.control.model_dump(mode="json", exclude_unset=True)
        fields |= {"motors": list(motors)} if motors else {}
        control = type(bundle.card.control).model_validate(fields | keys)
        card = bundle.card.model_copy(update={"control": control})
        return record(replace(bundle, card=card), scene="flat/carpet_room", seconds=2.0)

    return walked


def test_the_shipped_policy_walks_with_dc_motors_and_a_short_delay(walked):
    found = walked({"kind": "dc", "saturation_torque": 35.0, "no_load_speed": 30.0, "delay": 2})
    again = walked({"kind": "dc", "saturation_torque": 35.0, "no_load_speed": 30.0, "delay": 2})
    assert not found.stumbles
    assert found.travelled > 1.0
    np.testing.assert_array_equal(found.positions, again.positions)


def test_a_delay_of_an_action_is_that_of_its_physics_steps_but_for_the_start(walked):
    """Four physics steps are a control step of 0.02 s: `delay_steps` says the same."""
    physics = walked({"kind": "pd", "delay": 4}, delay_steps=0)
    control = walked({"kind": "pd"}, delay_steps=1)
    # From then on the policy sees two latencies of what was applied.
    np.testing.assert_array_equal(physics.positions[:3], control.positions[:3])
    assert np.abs(physics.positions[2] - physics.positions[0]).max() > 0.01
