"""The extreme-parkour expert and student against forward passes in NumPy."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch
from adapters import by_its_own_runtime

from nw_base.errors import PolicyError, TrialError
from nw_policies import load_bundle, open_policy
from nw_policies.networks.parkour import DepthEncoder, Estimator, ParkourActor
from nw_sim.rollout.confined.vetting import check_bundle

# The frames before the present one, oldest first; training kept the heading out of them.
HISTORY = """\
  history:
    sensor: proprio
    layout: parkour53
    history: {steps: 10, current: false, zero: ["6:8"]}
"""
EXPERT_CARD = """\
nw-policy: 1
name: parkour-expert
title: LucidSim's expert on scandots
robot: go1
adapter: extreme-parkour
checkpoint: {file: expert.pt, sha256: SHA256}
control: {action: joint_position_offset, scale: 0.25, clip: 4.8, delay_steps: 1, kp: 20, kd: 0.5}
observations:
  proprio: {sensor: proprio, layout: parkour53}
  scandots: {sensor: scandots}
HISTORYinputs: {proprio: [proprio], history: [history], scandots: [scandots]}
""".replace("HISTORY", HISTORY)
# Depth as training made it: (clip(metres, 0.28, 2) - 0.28) / 1.72 - 0.5.
STUDENT_CARD = """\
nw-policy: 1
name: parkour-student
robot: go1
adapter: extreme-parkour
checkpoint: {file: expert.pt, sha256: SHA256}
options: {depth_every: 5, steer_by_depth: true}
control: {action: joint_position_offset, scale: 0.25, clip: 4.8, delay_steps: 1}
observations:
  proprio: {sensor: proprio, layout: parkour53}
  depth:
    sensor: depth
    camera: ego
    width: 80
    height: 45
    rate: 10
    wrap:
      - {wrapper: clip, limits: [0.28, 2.0]}
      - {wrapper: normalize, mean: 0.28, std: 1.72}
      - {wrapper: scale, offset: -0.5}
HISTORYinputs: {proprio: [proprio], history: [history], depth: [depth]}
""".replace("HISTORY", HISTORY)


def randomized(module: torch.nn.Module, seed: int, prefix: str = "") -> dict[str, torch.Tensor]:
    rng = np.random.default_rng(seed)
    return {
        prefix + name: torch.tensor(
            rng.normal(0, max(int(np.prod(t.shape[1:])), 1) ** -0.5, t.shape), dtype=torch.float32
        )
        for name, t in module.state_dict().items()
    }


def checkpoint(*, student: bool = False) -> dict[str, object]:
    """A file as the training code writes it, with the parts that inference does not need."""
    actor = randomized(ParkourActor(), 1, "actor.")
    extra = {"std": torch.ones(12), "critic.0.weight": torch.ones(4, 4)}
    saved: dict[str, object] = {
        "model_state_dict": actor | extra,
        "estimator_state_dict": randomized(Estimator(), 2),
        "optimizer_state_dict": {"state": {0: {"step": 3, "exp_avg": torch.ones(3)}}},
        "iter": 15000,
        "infos": None,
    }
    if student:
        saved["depth_encoder_state_dict"] = randomized(DepthEncoder(41472), 3)
        saved["depth_actor_state_dict"] = randomized(ParkourActor(), 4)
    return saved


def save_bundle(folder: Path, card: str, saved: dict[str, object]) -> Path:
    torch.save(saved, folder / "expert.pt")
    digest = hashlib.sha256((folder / "expert.pt").read_bytes()).hexdigest()
    (folder / "policy.yaml").write_text(card.replace("SHA256", digest))
    return folder


def elu(x):
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0)))


def mlp(w, name, x, *, last=lambda x: x):
    layers = sorted(
        int(key.split(".")[-2]) for key in w if key.startswith(name) and "weight" in key
    )
    for layer in layers:
        x = w[f"{name}.{layer}.weight"] @ x + w[f"{name}.{layer}.bias"]
        x = last(x) if layer == layers[-1] else elu(x)
    return x


def conv1d(x, weight, bias, stride):
    """x (channels, length)."""
    size = weight.shape[2]
    starts = range(0, x.shape[1] - size + 1, stride)
    columns = [np.einsum("oci,ci->o", weight, x[:, start : start + size]) for start in starts]
    return np.stack(columns, axis=1) + bias[:, None]


def actor(w, estimator, proprio, latent, history):
    estimate = mlp(estimator, "estimator", proprio)
    name = "history_encoder.encoder.0"
    frames = elu(history @ w[f"{name}.weight"].T + w[f"{name}.bias"])
    name = "history_encoder.conv_layers"
    x = elu(conv1d(frames.T, w[f"{name}.0.weight"], w[f"{name}.0.bias"], 2))
    x = elu(conv1d(x, w[f"{name}.2.weight"], w[f"{name}.2.bias"], 1))
    name = "history_encoder.linear_output.0"
    past = elu(w[f"{name}.weight"] @ x.ravel() + w[f"{name}.bias"])
    return mlp(w, "actor_backbone", np.concatenate([proprio, latent, estimate, past]))


def doubles(tensors, prefix=""):
    return {
        name.removeprefix(prefix): tensor.numpy().astype(np.float64)
        for name, tensor in tensors.items()
    }


def test_expert_has_the_published_number_of_parameters():
    # Golden number: of the published training code, counted there.
    count = sum(p.numel() for m in (ParkourActor(), Estimator()) for p in m.parameters())
    assert count == 276_055


def test_expert_agrees_with_numpy(tmp_path):
    saved = checkpoint()
    policy = open_policy(load_bundle(save_bundle(tmp_path, EXPERT_CARD, saved)))
    rng = np.random.default_rng(0)
    proprio, scandots, history = (rng.normal(size=n).astype(np.float32) for n in (53, 132, 530))
    policy.reset(0)
    action = policy.act({"proprio": proprio, "scandots": scandots, "history": history})
    w = doubles(saved["model_state_dict"], "actor.")
    latent = mlp(w, "scan_encoder", scandots, last=np.tanh)
    expected = actor(
        w, doubles(saved["estimator_state_dict"]), proprio, latent, history.reshape(10, 53)
    )
    assert np.abs(expected).max() > 0.05
    np.testing.assert_allclose(action, expected, atol=1e-5, rtol=1e-5)


def test_the_experts_card_makes_the_753_numbers_less_the_hidden_ones(tmp_path):
    specs = check_bundle(load_bundle(save_bundle(tmp_path, EXPERT_CARD, checkpoint())))
    sizes = {spec.name: spec.shape for spec in specs}
    assert sizes == {"proprio": (53,), "scandots": (132,), "history": (530,)}
    assert 53 + 132 + 530 + (9 + 29) == 753  # The published vector
    specs = check_bundle(load_bundle(save_bundle(tmp_path, STUDENT_CARD, checkpoint(student=True))))
    sizes = {spec.name: spec.shape for spec in specs}
    assert sizes == {"proprio": (53,), "depth": (45, 80), "history": (530,)}


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def conv2d(x, weight, bias):
    size = weight.shape[-1]
    windows = np.lib.stride_tricks.sliding_window_view(x, (size, size), axis=(1, 2))
    return np.einsum("chwij,ocij->ohw", windows, weight, optimize=True) + bias[:, None, None]


def see(w, depth, proprio, hidden):
    """The specification's depth encoder: (45, 80), (53,), (512,) to (34,), (512,)."""
    name = "base_backbone.image_compression"
    x = conv2d(depth[None], w[f"{name}.0.weight"], w[f"{name}.0.bias"])
    x = elu(x.reshape(32, 41, 76)[:, :40, :76].reshape(32, 20, 2, 38, 2).max(axis=(2, 4)))
    x = elu(conv2d(x, w[f"{name}.3.weight"], w[f"{name}.3.bias"])).ravel()
    x = elu(w[f"{name}.6.weight"] @ x + w[f"{name}.6.bias"])
    x = elu(w[f"{name}.8.weight"] @ x + w[f"{name}.8.bias"])
    blind = proprio.copy()
    blind[6:8] = 0
    x = mlp(w, "combination_mlp", np.concatenate([x, blind]))
    gi = w["rnn.weight_ih_l0"] @ x + w["rnn.bias_ih_l0"]
    gh = w["rnn.weight_hh_l0"] @ hidden + w["rnn.bias_hh_l0"]
    reset, update = (sigmoid(gi[a : a + 512] + gh[a : a + 512]) for a in (0, 512))
    new = np.tanh(gi[1024:] + reset * gh[1024:])
    hidden = (1 - update) * new + update * hidden
    return np.tanh(w["output_mlp.0.weight"] @ hidden + w["output_mlp.0.bias"]), hidden


def test_student_agrees_with_numpy_over_ten_steps_and_looks_at_every_fifth_image(tmp_path):
    saved = checkpoint(student=True)
    policy = open_policy(load_bundle(save_bundle(tmp_path, STUDENT_CARD, saved)))
    encoder, w = (doubles(saved[f"depth_{part}_state_dict"]) for part in ("encoder", "actor"))
    estimator = doubles(saved["estimator_state_dict"])
    rng = np.random.default_rng(0)
    policy.reset(0)
    hidden, seen = np.zeros(512), np.zeros(34)
    for step in range(10):
        proprio, history = (rng.normal(size=n).astype(np.float32) for n in (53, 530))
        depth = rng.uniform(-0.5, 0.5, (45, 80)).astype(np.float32)
        action = policy.act({"proprio": proprio, "history": history, "depth": depth})
        if step % 5 == 0:
            seen, hidden = see(encoder, depth.astype(np.float64), proprio, hidden)
        steered = proprio.astype(np.float64)
        steered[6:8] = 1.5 * seen[32:]
        expected = actor(w, estimator, steered, seen[:32], history.reshape(10, 53))
        np.testing.assert_allclose(action, expected, atol=1e-5, rtol=1e-5)


def test_student_continues_from_a_saved_state_bit_for_bit(tmp_path):
    bundle = load_bundle(save_bundle(tmp_path, STUDENT_CARD, checkpoint(student=True)))
    rng = np.random.default_rng(0)
    observations = [
        {
            "proprio": rng.normal(size=53).astype(np.float32),
            "history": rng.normal(size=530).astype(np.float32),
            "depth": rng.normal(size=(45, 80)).astype(np.float32),
        }
        for _ in range(14)
    ]
    first = open_policy(bundle)
    first.reset(0)
    for observation in observations[:7]:
        first.act(observation)
    state = first.state()
    rest = [first.act(observation) for observation in observations[7:]]
    second = open_policy(bundle)
    second.reset(1)
    second.restore(state)
    np.testing.assert_array_equal(rest, [second.act(o) for o in observations[7:]])
    second.reset(2)
    first.reset(3)
    np.testing.assert_array_equal(first.act(observations[0]), second.act(observations[0]))


def test_a_state_of_something_else_is_refused(tmp_path):
    bundle = load_bundle(save_bundle(tmp_path, STUDENT_CARD, checkpoint(student=True)))
    policy = open_policy(by_its_own_runtime(bundle))
    for state in (b"", b"nonsense"):
        with pytest.raises(TrialError, match="the state does not fit policy 'parkour-student'"):
            policy.restore(state)


def test_a_network_that_remembers_nothing_refuses_what_another_one_remembered(tmp_path):
    policy = open_policy(load_bundle(save_bundle(tmp_path, EXPERT_CARD, checkpoint())))
    assert policy.state() == b""
    policy.restore(b"")
    with pytest.raises(TrialError, match="does not fit policy 'parkour-expert': 8 bytes"):
        policy.restore(bytes(8))


def test_a_depth_card_with_an_experts_checkpoint_is_refused(tmp_path):
    bundle = load_bundle(save_bundle(tmp_path, STUDENT_CARD, checkpoint()))
    with pytest.raises(PolicyError, match="this is an expert, not a depth student"):
        open_policy(bundle)


def test_an_unknown_option_is_refused_with_the_nearest_name(tmp_path):
    card = STUDENT_CARD.replace("depth_every", "depth_evry")
    bundle = load_bundle(save_bundle(tmp_path, card, checkpoint(student=True)))
    with pytest.raises(
        PolicyError, match=r"unknown option 'depth_evry' .did you mean 'depth_every'"
    ):
        open_policy(bundle)
