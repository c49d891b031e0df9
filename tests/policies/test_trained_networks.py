"""Checkpoints as trainings save them act as the trainers' own inference does.

Each folder of `trained/` has a file that the trainer itself wrote, on CPU, after some updates on
random observations, and `expected.json`: the trainer with its version, four observations in a row
and the actions that its own inference gave (rsl_rl's `get_inference_policy`, skrl's `act`, the
player of rl_games, `predict` of Stable-Baselines3, brax' `make_inference_fn`, flax' `apply`, the
class `Agent` of CleanRL's ppo_continuous_action with 8 units a layer).
"""

import json
import os
import pickle  # noqa: TID251 - it writes what must not be executed.
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from adapters import by_its_own_runtime

from nw_base.errors import PolicyError, TrialError
from nw_eval.api.policies import init_policy
from nw_policies import load_bundle, open_policy
from nw_policies.drafting.draft import draft_of
from nw_policies.safety import read_tensors, tensor_facts

TRAINED = Path(__file__).parent / "trained"
NAMES = sorted(path.name for path in TRAINED.iterdir())
RECURRENT = ["rl-games-gru", "rsl-rl-1-lstm", "rsl-rl-3-gru", "rsl-rl-5-lstm"]


def saved(name: str) -> Path:
    return next(path for path in (TRAINED / name).iterdir() if path.suffix != ".json")


@pytest.fixture
def drafted(tmp_path):
    """Draft the card of a checkpoint, with replacements in its text, and return its folder."""

    def draft(name: str, **changes: str) -> Path:
        file = shutil.copy(saved(name), tmp_path)
        text = draft_of(checkpoint=file, robot="go1", folder=str(tmp_path))["text"]
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "policy.yaml").write_text(text)
        return tmp_path

    return draft


def acted(policy, bundle, observations) -> np.ndarray:
    (name,) = bundle.card.observations
    actions = np.array([policy.act({name: np.array(o, np.float32)}) for o in observations])
    clip = bundle.card.control.clip
    return actions if clip is None else np.clip(actions, *clip)


def expected(name: str) -> dict:
    return json.loads((TRAINED / name / "expected.json").read_text())


@pytest.mark.parametrize("name", NAMES)
def test_the_drafted_card_acts_as_the_trainers_own_inference(name, drafted):
    bundle = load_bundle(drafted(name))
    policy = open_policy(bundle)
    policy.reset(0)
    want = expected(name)
    actions = acted(policy, bundle, want["observations"])
    np.testing.assert_allclose(actions, want["actions"], rtol=0, atol=1e-6)
    assert np.ptp(actions, axis=0).max() > 1e-3, "the policy sees its observations"


@pytest.mark.parametrize("name", ["rsl-rl-1", "sb3-elu", "brax"])
def test_another_activation_is_another_policy(name, drafted):
    habit = "silu" if name == "brax" else "elu"
    bundle = load_bundle(drafted(name, **{f"activation: {habit}": "activation: relu"}))
    policy = open_policy(bundle)
    policy.reset(0)
    want = expected(name)
    actions = acted(policy, bundle, want["observations"])
    assert np.abs(actions - want["actions"]).max() > 1e-3


@pytest.mark.parametrize("name", RECURRENT)
def test_a_recurrent_policy_goes_on_from_its_state_bit_for_bit(name, drafted):
    bundle = load_bundle(drafted(name))
    policy, other = open_policy(bundle), open_policy(bundle)
    seen = expected(name)["observations"]
    policy.reset(0)
    whole = acted(policy, bundle, seen)
    policy.reset(0)
    acted(policy, bundle, seen[:2])
    other.reset(0)
    forgetful = acted(other, bundle, seen[2:])
    other.restore(policy.state())
    assert np.array_equal(acted(other, bundle, seen[2:]), whole[2:])
    assert not np.allclose(forgetful, whole[2:])


def test_a_state_of_another_policy_is_refused(drafted):
    policy = open_policy(by_its_own_runtime(load_bundle(drafted("rsl-rl-1"))))
    with pytest.raises(TrialError, match="does not fit"):
        policy.restore(b"12")


def test_the_activation_of_stable_baselines3_is_read_from_its_file(drafted):
    text = (drafted("sb3-elu") / "policy.yaml").read_text()
    assert "  activation: elu  # best_model.zip" in text
    text = draft_of(checkpoint=str(saved("sb3")), robot="go1", folder=".")["text"]
    assert "  activation: tanh  # CHECK" in text


def test_what_no_file_says_is_to_be_checked(drafted):
    text = (drafted("rsl-rl-1") / "policy.yaml").read_text()
    assert "  activation: elu  # CHECK: it is not in the file; elu is rsl_rl's habit" in text
    assert "  # rsl_rl: 45 -> 8 -> 8 -> 12" in text
    assert "obs: 1 x 45 float32" in text


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("weights: actor_mean", "weights: actor_men", "begins with 'actor_men'.*actor_mean"),
        ("weights: actor_mean", "weights: critic", r"'critic\.4', gives 1 numbers.*12 joints"),
        (
            "weights: actor_mean",
            "weights: [actor_mean, critic]",
            r"'actor_mean\.4' gives 12 numbers, 'critic\.0' takes 45",
        ),
        ("activation: tanh", "activation: tanhh", "option 'activation'"),
        ("activation: tanh", "activatoin: tanh", "unknown option 'activatoin'.*activation"),
        (
            "# normaliser: none",
            "normaliser: {mean: actor_logstd, std: actor_logstd}",
            "'actor_logstd' has 12 numbers, the first layer takes 45",
        ),
        ("# normaliser: none", "normaliser: {mean: seen}", "name one of `std` and `variance`"),
    ],
)
def test_a_card_that_does_not_fit_the_file_says_where(old, new, reason, drafted):
    with pytest.raises(PolicyError, match=reason):
        open_policy(load_bundle(drafted("cleanrl", **{old: new})))


def test_a_network_beside_the_actor_is_named(tmp_path):
    layers = {"actor.0": (8, 64), "actor.2": (12, 8), "estimator.0": (19, 270), "critic.0": (1, 45)}
    state = {f"{name}.weight": torch.zeros(shape) for name, shape in layers.items()}
    torch.save({"model_state_dict": state}, tmp_path / "model_9.pt")
    text = draft_of(checkpoint=str(tmp_path / "model_9.pt"), robot="go1", folder=str(tmp_path))[
        "text"
    ]
    assert "CHECK: the file has other networks: model_state_dict.estimator." in text


class Runs:
    def __reduce__(self):
        return os.system, ("touch ran",)


@pytest.mark.parametrize("protocol", range(6))
def test_a_pickle_that_would_run_a_command_runs_none(protocol, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    params = ({"mean": np.zeros(45)}, {"params": {"hidden_0": {"kernel": Runs()}}})
    Path("params").write_bytes(pickle.dumps(params, protocol=protocol))
    with pytest.raises(PolicyError, match=r"asks to call|has the instruction|format of the file"):
        init_policy(Path("params"), robot="go1")
    assert not Path("ran").exists()
    pickle.loads(Path("params").read_bytes())
    assert Path("ran").exists(), "the pickle does what it says where it is loaded"


def test_an_object_of_any_other_class_is_refused(tmp_path):
    path = tmp_path / "params"
    path.write_bytes(pickle.dumps({"policy": torch.nn.Linear(45, 12)}))
    with pytest.raises(PolicyError, match="not opened"):
        read_tensors(path.read_bytes(), "params")


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["f4", "f8", "f2", "i8", "u4", "b1"])
def test_arrays_of_a_pickle_are_read_as_numpy_reads_them(dtype, order):
    array = np.asarray(np.arange(24).reshape(2, 3, 4) % 7, dtype=dtype, order=order)
    data = pickle.dumps({"a": array, "b": (np.zeros(()), np.zeros((0, 3), "f4"))})
    tensors = read_tensors(data, "params")
    assert [(f.name, f.shape) for f in tensor_facts(data, "params")] == [
        ("a", (2, 3, 4)),
        ("b.0", ()),
        ("b.1", (0, 3)),
    ]
    assert np.array_equal(tensors["a"].numpy(), array)
    assert tensors["a"].numpy().dtype == array.dtype


def test_an_array_that_claims_more_than_it_has_is_refused():
    data = pickle.dumps({"a": np.zeros(300, "f4")})
    forged = data.replace(b"M\x2c\x01\x85", b"M\xff\xff\x85")  # The shape (300,).
    assert forged != data
    with pytest.raises(PolicyError, match=r"shape \(65535,\) with 1200 bytes"):
        read_tensors(forged, "params")


def test_numbers_of_another_byte_order_are_refused():
    data = pickle.dumps({"a": np.zeros(3, ">f4")})
    with pytest.raises(PolicyError, match="big-endian"):
        read_tensors(data, "params")


def test_a_damaged_msgpack_file_is_refused():
    data = saved("flax").read_bytes()
    for broken in (data[:-5], data.replace(b"\xa7float32", b"\xa7float99")):
        with pytest.raises(PolicyError, match="msgpack file is damaged"):
            read_tensors(broken, "actor.msgpack")


def test_the_pickles_beside_the_weights_in_a_zip_stay_shut(tmp_path):
    with zipfile.ZipFile(saved("sb3")) as old, zipfile.ZipFile(tmp_path / "x.zip", "w") as new:
        for name in old.namelist():
            evil = name == "pytorch_variables.pth"
            new.writestr(name, pickle.dumps(Runs()) if evil else old.read(name))
    ours = read_tensors((tmp_path / "x.zip").read_bytes(), "x.zip")
    assert "action_net.weight" in ours
