"""The LucidSim transformer against a forward pass in NumPy, written from the specification.

The NumPy side shares no code with the network: loops over patches and heads, float64.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch
from adapters import by_its_own_runtime

from nw_base.errors import PolicyError, TrialError
from nw_policies import load_bundle, open_policy
from nw_policies.networks.parameters import build
from nw_policies.networks.parkour import LucidSimTransformer
from nw_sim.rollout.confined.vetting import check_bundle

CARD = """\
nw-policy: 1
name: lucidsim-hurdle
title: LucidSim's transformer, hurdles
robot: go1
adapter: lucidsim
checkpoint: {{file: hurdle.pt, sha256: {sha256}}}
control: {{action: joint_position_offset, scale: 0.25, clip: 4.8, delay_steps: 1, kp: 20, kd: 0.5}}
command: {{source: waypoint, speed: 0.8}}
observations:
  proprio: {{sensor: proprio, layout: parkour53}}
  rgb:
    sensor: splat_rgb
    camera: ego
    width: 80
    height: 45
    sampling: published
    stack: 7
    axes: chw
    dtype: float32
    mean: 127.5
    std: 255
inputs:
  proprio: [proprio]
  frames: [rgb]
"""


def random_weights(seed: int = 0) -> dict[str, torch.Tensor]:
    """A state dict with the published names and shapes."""
    rng = np.random.default_rng(seed)
    weights = {}
    for name, tensor in LucidSimTransformer().state_dict().items():
        fan = max(int(np.prod(tensor.shape[1:])), 1)
        array = rng.normal(0, fan**-0.5, tensor.shape)
        if name.endswith(("gamma", "running_var", "img_enc.0.weight")):
            array = rng.uniform(0.5, 1.5, tensor.shape)
        if name.endswith(("beta", "scale")):
            array = np.zeros(tensor.shape)
        if name.endswith("inv_freq"):
            array = 10000.0 ** (-2 * np.arange(32) / 64)
        dtype = torch.int64 if name.endswith("tracked") else torch.float32
        weights[name] = torch.tensor(array, dtype=dtype)
    return weights


def forward(weights: dict[str, torch.Tensor], proprio, frames):
    """The specification's forward pass: proprio (7, 53), frames (7, 3, 45, 80) to (12,)."""
    w = {name: tensor.numpy().astype(np.float64) for name, tensor in weights.items()}
    vectors = proprio @ w["obs_enc.weight"][:, :, 0].T + w["obs_enc.bias"]
    tokens = [vectors]
    mean, var = w["img_enc.0.running_mean"], w["img_enc.0.running_var"]
    for frame in frames:
        x = (frame - mean[:, None, None]) / np.sqrt(var[:, None, None] + 1e-5)
        x = x * w["img_enc.0.weight"][:, None, None] + w["img_enc.0.bias"][:, None, None]
        first = np.zeros((64, 5, 10))
        for row in range(5):
            for column in range(10):
                patch = x[:, 8 * row : 8 * row + 8, 8 * column : 8 * column + 8]
                first[:, row, column] = np.einsum("ocij,cij->o", w["img_enc.1.weight"], patch)
        first = np.maximum(first + w["img_enc.1.bias"][:, None, None], 0)
        for row in range(4):
            for column in range(9):
                patch = first[:, row : row + 2, column : column + 2]
                token = np.einsum("ocij,cij->o", w["img_enc.3.weight"], patch)
                tokens.append((token + w["img_enc.3.bias"])[None])
    x = np.concatenate([*tokens, w["act_tokens"][0, :1]])
    assert x.shape == (260, 128)
    for layer in range(5):
        x = block(x, {k.split(".", 2)[2]: v for k, v in w.items() if f"former.{layer}." in k})
    return x[-1] @ w["act_proj.0.weight"].T + w["act_proj.0.bias"]


def block(x, w):
    centred = x - x.mean(axis=1, keepdims=True)
    h = centred / np.sqrt((centred**2).mean(axis=1, keepdims=True) + 1e-5) * w["norm.gamma"]
    q, k, v, up, gate = np.split(
        h @ w["fused_attn_ff_proj.weight"].T, [512, 576, 640, 1152], axis=1
    )
    angles = np.arange(260)[:, None] * 10000.0 ** (-2 * np.arange(32) / 64)
    cos, sin = np.cos(np.tile(angles, 2)), np.sin(np.tile(angles, 2))

    def rotate(z):
        return z * cos + np.concatenate([-z[:, 32:], z[:, :32]], axis=1) * sin

    k = rotate(k)
    heads = []
    for head in range(8):
        scores = rotate(q[:, 64 * head : 64 * head + 64]) @ k.T / 8
        scores = np.exp(scores - scores.max(axis=1, keepdims=True))
        heads.append(scores / scores.sum(axis=1, keepdims=True) @ v)
    silu = gate / (1 + np.exp(-gate))
    attention = np.concatenate(heads, axis=1) @ w["attn_out.weight"].T
    return attention + (silu * up) @ w["ff_out.2.weight"].T


def run(weights: dict[str, torch.Tensor], proprio, frames):
    """The network's action for proprio (7, 53) and frames (7, 3, 45, 80)."""
    session = build(LucidSimTransformer, weights, "w.pt", unused=("yaw",)).open()
    return session.run(None, {"proprio": np.float32(proprio), "frames": np.float32(frames)})[0][0]


def save_bundle(folder: Path, tensors: dict[str, torch.Tensor]) -> Path:
    torch.save(tensors, folder / "hurdle.pt")
    digest = hashlib.sha256((folder / "hurdle.pt").read_bytes()).hexdigest()
    (folder / "policy.yaml").write_text(CARD.format(sha256=digest))
    return folder


def test_state_dict_has_the_published_entries_and_size():
    # Golden numbers: of the published model definition, counted there.
    network = LucidSimTransformer()
    state = network.state_dict()
    assert len(state) == 57
    assert sum(p.numel() for p in network.parameters()) == 1_823_972
    assert state["transformer.4.fused_attn_ff_proj.weight"].shape == (1664, 128)
    assert state["act_tokens"].shape == (1, 300, 128)
    assert state["yaw_proj.6.weight"].shape == (2, 16)


@pytest.mark.parametrize("seed", [0, 1])
def test_forward_pass_agrees_with_numpy(seed):
    weights = random_weights(seed)
    rng = np.random.default_rng(100 + seed)
    proprio, frames = rng.normal(size=(7, 53)), rng.uniform(-0.5, 0.5, (7, 3, 45, 80))
    expected = forward(weights, proprio, frames)
    assert np.abs(expected).max() > 0.05
    np.testing.assert_allclose(run(weights, proprio, frames), expected, atol=1e-5, rtol=1e-5)


def test_an_action_has_the_same_bits_after_other_observations_and_in_another_session():
    weights = random_weights()
    rng = np.random.default_rng(7)
    steps = [
        {
            "proprio": rng.normal(size=(7, 53)).astype(np.float32),
            "frames": rng.uniform(-0.5, 0.5, (7, 3, 45, 80)).astype(np.float32),
        }
        for _ in range(3)
    ]
    network = build(LucidSimTransformer, weights, "w.pt")
    session = network.open()
    actions = [session.run(None, step)[0] for step in steps]
    assert not np.array_equal(actions[0], actions[2])
    np.testing.assert_array_equal(session.run(None, steps[0])[0], actions[0])
    np.testing.assert_array_equal(network.open().run(None, steps[2])[0], actions[2])


@pytest.mark.parametrize("layer", range(5))
def test_every_block_rotates_by_its_own_frequencies(layer):
    weights = random_weights()
    name = f"transformer.{layer}.rotary_emb.inv_freq"
    rng = np.random.default_rng(5)
    inputs = rng.normal(size=(7, 53)), rng.uniform(-0.5, 0.5, (7, 3, 45, 80))
    changed = run(weights | {name: weights[name] * 0.1}, *inputs)
    assert not np.array_equal(changed, run(weights, *inputs))


def test_yaw_keys_may_be_missing_or_of_another_shape():
    weights = random_weights()
    without = {name: tensor for name, tensor in weights.items() if "yaw" not in name}
    reshaped = weights | {
        "yaw_proj.6.weight": torch.zeros(3, 16),
        "yaw_proj.8.bias": torch.zeros(1),
    }
    inputs = np.zeros((7, 53)), np.zeros((7, 3, 45, 80))
    actions = [run(w, *inputs) for w in (weights, without, reshaped)]
    np.testing.assert_array_equal(actions[0], actions[1])
    np.testing.assert_array_equal(actions[0], actions[2])


def test_missing_unknown_and_misshapen_weights_are_one_error():
    weights = random_weights()
    del weights["obs_enc.bias"]
    weights["act_proj.0.weight"] = torch.zeros(10, 128)
    weights["img_enc.1.weigth"] = torch.zeros(1)
    with pytest.raises(PolicyError) as caught:
        build(LucidSimTransformer, weights, "hurdle.pt", unused=("yaw",))
    message = str(caught.value)
    assert "hurdle.pt" in message
    assert "'obs_enc.bias' is missing" in message
    assert "'act_proj.0.weight' has shape (10, 128), not (12, 128)" in message
    assert "did you mean 'img_enc.1.weight'?" in message


def test_the_card_runs_with_the_present_frame_seven_times(tmp_path):
    weights = random_weights()
    policy = open_policy(by_its_own_runtime(load_bundle(save_bundle(tmp_path, weights))))
    rng = np.random.default_rng(5)
    proprio = rng.normal(size=53).astype(np.float32)
    frames = rng.uniform(-0.5, 0.5, (7, 3, 45, 80)).astype(np.float32)
    policy.reset(0)
    action = policy.act({"proprio": proprio, "rgb": frames})
    expected = forward(weights, np.tile(proprio.astype(np.float64), (7, 1)), frames)
    np.testing.assert_allclose(action, expected, atol=1e-5, rtol=1e-5)
    stacked = policy.act({"proprio": np.tile(proprio, 7), "rgb": frames})
    np.testing.assert_array_equal(action, stacked)
    assert policy.state() == b""


def test_the_cards_observations_are_those_that_the_network_takes(tmp_path):
    specs = check_bundle(load_bundle(save_bundle(tmp_path, random_weights())))
    assert {spec.name: spec.shape for spec in specs} == {"proprio": (53,), "rgb": (7, 3, 45, 80)}


def test_a_vector_of_another_length_is_said_in_the_cards_terms(tmp_path):
    policy = open_policy(by_its_own_runtime(load_bundle(save_bundle(tmp_path, random_weights()))))
    with pytest.raises(TrialError, match="`proprio` is 48 numbers; the transformer wants 53"):
        policy.act({"proprio": np.zeros(48), "rgb": np.zeros((7, 3, 45, 80), np.float32)})
