"""ACT against a forward pass in NumPy, and its chunks against the definition of ensembling."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch

from nw_base.errors import PolicyError, TrialError
from nw_policies import load_bundle, open_policy
from nw_policies.chunks import ChunkQueue
from nw_policies.networks.act import Act
from nw_sim.rollout.confined.vetting import check_bundle

CARD = """\
nw-policy: 1
name: act-rgb
title: ACT on splat images
robot: go1
adapter: act
checkpoint: {file: act.pt, sha256: SHA256}
options: {heads: 4, ensemble: 0.01, query_every: 1}
control: {action: joint_position_offset, scale: 0.25, clip: 4.8, delay_steps: 1}
observations:
  proprio: {sensor: proprio, layout: parkour53}
  rgb: {sensor: splat_rgb, camera: ego, width: 80, height: 45, axes: chw, dtype: float32}
inputs: {proprio: [proprio], images: [rgb]}
"""
WIDTH, HEADS, CHUNK, FORWARD = 32, 4, 10, 48


def layout(*, backbone: dict[str, tuple[int, ...]], maps: int, pre_norm: bool) -> dict:
    """Names and shapes of a state dict, written out from the documented layout."""
    shapes = {f"backbone.{name}": shape for name, shape in backbone.items()}
    if maps:
        shapes |= {"encoder_img_feat_input_proj.weight": (WIDTH, maps, 1, 1)}
        shapes |= {"encoder_img_feat_input_proj.bias": (WIDTH,)}
    linear = {
        "encoder_robot_state_input_proj": (WIDTH, 53),
        "encoder_latent_input_proj": (WIDTH, 8),
    }
    linear["action_head"] = (12, WIDTH)
    norms = []
    attentions = []
    for part, layers, count in (("encoder", 2, 2), ("decoder", 1, 3)):
        for layer in range(layers):
            name = f"{part}.layers.{layer}"
            attentions.append(f"{name}.self_attn")
            if part == "decoder":
                attentions.append(f"{name}.multihead_attn")
            linear |= {f"{name}.linear1": (FORWARD, WIDTH), f"{name}.linear2": (WIDTH, FORWARD)}
            norms += [f"{name}.norm{i + 1}" for i in range(count)]
    norms += ["decoder.norm"] + ["encoder.norm"] * pre_norm
    for name in attentions:
        shapes |= {
            f"{name}.in_proj_weight": (3 * WIDTH, WIDTH),
            f"{name}.in_proj_bias": (3 * WIDTH,),
        }
        linear[f"{name}.out_proj"] = (WIDTH, WIDTH)
    for name, shape in linear.items():
        shapes |= {f"{name}.weight": shape, f"{name}.bias": shape[:1]}
    for name in norms:
        shapes |= {f"{name}.weight": (WIDTH,), f"{name}.bias": (WIDTH,)}
    shapes |= {"encoder_1d_feature_pos_embed.weight": (2, WIDTH)}
    shapes |= {"decoder_pos_embed.weight": (CHUNK, WIDTH)}
    return shapes


SMALL = {
    "0.weight": (8, 3, 5, 5),
    "0.bias": (8,),
    "2.weight": (16, 8, 3, 3),
    "2.bias": (16,),
    "4.weight": (16, 16, 3, 3),
    "4.bias": (16,),
}


def resnet18() -> dict[str, tuple[int, ...]]:
    def norm(name, n):
        return {f"{name}.{k}": (n,) for k in ("weight", "bias", "running_mean", "running_var")}

    shapes = {"conv1.weight": (64, 3, 7, 7)} | norm("bn1", 64)
    inputs = 64
    for stage, outputs in enumerate((64, 128, 256, 512), start=1):
        for block in range(2):
            name = f"layer{stage}.{block}"
            shapes |= {f"{name}.conv1.weight": (outputs, inputs, 3, 3)} | norm(
                f"{name}.bn1", outputs
            )
            shapes |= {f"{name}.conv2.weight": (outputs, outputs, 3, 3)}
            shapes |= norm(f"{name}.bn2", outputs)
            if inputs != outputs:
                shapes |= {f"{name}.downsample.0.weight": (outputs, inputs, 1, 1)}
                shapes |= norm(f"{name}.downsample.1", outputs)
            inputs = outputs
    return shapes


def randomized(shapes: dict, seed: int = 0) -> dict[str, torch.Tensor]:
    rng = np.random.default_rng(seed)
    weights = {}
    for name, shape in shapes.items():
        array = rng.normal(0, max(int(np.prod(shape[1:])), 1) ** -0.5, shape)
        if name.endswith("running_var") or (".norm" in name and name.endswith("weight")):
            array = rng.uniform(0.5, 1.5, shape)
        if ".bn" in name and name.endswith((".weight", ".bias")):
            array = rng.uniform(0.2, 0.8, shape)
        weights[name] = torch.tensor(array, dtype=torch.float32)
    return weights


def conv2d(x, weight, bias=None, *, stride=1, padding=0):
    size = weight.shape[-1]
    x = np.pad(x, ((0, 0), (padding, padding), (padding, padding)))
    windows = np.lib.stride_tricks.sliding_window_view(x, (size, size), axis=(1, 2))
    y = np.einsum("chwij,ocij->ohw", windows[:, ::stride, ::stride], weight, optimize=True)
    return y if bias is None else y + bias[:, None, None]


def small_backbone(w, image):
    x = np.maximum(conv2d(image, w["0.weight"], w["0.bias"], stride=2, padding=2), 0)
    for name in ("2", "4"):
        x = conv2d(x, w[f"{name}.weight"], w[f"{name}.bias"], stride=2, padding=1)
        x = np.maximum(x, 0)
    return x


def resnet_backbone(w, image):
    def norm(name, x):
        mean, var = w[f"{name}.running_mean"], w[f"{name}.running_var"]
        scale = w[f"{name}.weight"] / np.sqrt(var + 1e-5)
        return (x - mean[:, None, None]) * scale[:, None, None] + w[f"{name}.bias"][:, None, None]

    x = np.maximum(norm("bn1", conv2d(image, w["conv1.weight"], stride=2, padding=3)), 0)
    padded = np.pad(x, ((0, 0), (1, 1), (1, 1)), constant_values=-np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2))
    x = windows[:, ::2, ::2].max(axis=(3, 4))
    for stage in range(1, 5):
        for block in range(2):
            name, stride = f"layer{stage}.{block}", 2 if stage > 1 and block == 0 else 1
            y = conv2d(x, w[f"{name}.conv1.weight"], stride=stride, padding=1)
            y = conv2d(np.maximum(norm(f"{name}.bn1", y), 0), w[f"{name}.conv2.weight"], padding=1)
            if f"{name}.downsample.0.weight" in w:
                x = conv2d(x, w[f"{name}.downsample.0.weight"], stride=stride)
                x = norm(f"{name}.downsample.1", x)
            x = np.maximum(norm(f"{name}.bn2", y) + x, 0)
    return x


def layer_norm(w, name, x):
    x = x - x.mean(axis=1, keepdims=True)
    x = x / np.sqrt((x**2).mean(axis=1, keepdims=True) + 1e-5)
    return x * w[f"{name}.weight"] + w[f"{name}.bias"]


def linear(w, name, x):
    return x @ w[f"{name}.weight"].T + w[f"{name}.bias"]


def attention(w, name, query, key, value):
    projected = [
        x @ w[f"{name}.in_proj_weight"][WIDTH * i : WIDTH * (i + 1)].T
        + w[f"{name}.in_proj_bias"][WIDTH * i : WIDTH * (i + 1)]
        for i, x in enumerate((query, key, value))
    ]
    size = WIDTH // HEADS
    out = []
    for head in range(HEADS):
        q, k, v = (x[:, size * head : size * (head + 1)] for x in projected)
        scores = np.exp(q @ k.T / np.sqrt(size))
        out.append(scores / scores.sum(axis=1, keepdims=True) @ v)
    return linear(w, f"{name}.out_proj", np.concatenate(out, axis=1))


def places(rows, columns):
    """Sines and cosines of places 1..n scaled to 2 pi: half the width for y, half for x."""
    table = np.zeros((rows, columns, WIDTH))
    half = WIDTH // 2
    for row in range(rows):
        for column in range(columns):
            for axis, (place, count) in enumerate(((row + 1, rows), (column + 1, columns))):
                angle = place / (count + 1e-6) * 2 * np.pi
                for i in range(half):
                    wave = angle / 10000 ** (2 * (i // 2) / half)
                    table[row, column, axis * half + i] = np.cos(wave) if i % 2 else np.sin(wave)
    return table.reshape(-1, WIDTH)


def forward(weights, backbone, proprio, images, *, pre_norm):
    w = {name: tensor.numpy().astype(np.float64) for name, tensor in weights.items()}
    if "normalize.proprio.mean" in w:
        proprio = (proprio - w["normalize.proprio.mean"]) / w["normalize.proprio.std"]
    tokens = [linear(w, "encoder_latent_input_proj", np.zeros((1, 8)))]
    tokens.append(linear(w, "encoder_robot_state_input_proj", proprio[None]))
    position = [w["encoder_1d_feature_pos_embed.weight"]]
    encoder = {k.removeprefix("backbone."): v for k, v in w.items() if k.startswith("backbone.")}
    for image in images:
        features = backbone(encoder, image)
        projection = w["encoder_img_feat_input_proj.weight"][:, :, 0, 0]
        mapped = np.einsum("oc,chw->hwo", projection, features)
        tokens.append(mapped.reshape(-1, WIDTH) + w["encoder_img_feat_input_proj.bias"])
        position.append(places(*features.shape[1:]))
    x, at = np.concatenate(tokens), np.concatenate(position)
    first = (lambda n, z: layer_norm(w, n, z)) if pre_norm else (lambda _, z: z)
    then = (lambda _, z: z) if pre_norm else (lambda n, z: layer_norm(w, n, z))
    for layer in range(2):
        name = f"encoder.layers.{layer}"
        h = first(f"{name}.norm1", x)
        x = then(f"{name}.norm1", x + attention(w, f"{name}.self_attn", h + at, h + at, h))
        h = np.maximum(linear(w, f"{name}.linear1", first(f"{name}.norm2", x)), 0)
        x = then(f"{name}.norm2", x + linear(w, f"{name}.linear2", h))
    memory = layer_norm(w, "encoder.norm", x) if pre_norm else x
    name, step = "decoder.layers.0", w["decoder_pos_embed.weight"]
    y = np.zeros((CHUNK, WIDTH))
    h = first(f"{name}.norm1", y)
    y = then(f"{name}.norm1", y + attention(w, f"{name}.self_attn", h + step, h + step, h))
    h = first(f"{name}.norm2", y)
    seen = attention(w, f"{name}.multihead_attn", h + step, memory + at, memory)
    y = then(f"{name}.norm2", y + seen)
    h = np.maximum(linear(w, f"{name}.linear1", first(f"{name}.norm3", y)), 0)
    y = then(f"{name}.norm3", y + linear(w, f"{name}.linear2", h))
    actions = linear(w, "action_head", layer_norm(w, "decoder.norm", y))
    if "normalize.action.mean" in w:
        actions = actions * w["normalize.action.std"] + w["normalize.action.mean"]
    return actions


def save_bundle(folder: Path, weights: dict[str, torch.Tensor], card: str = CARD) -> Path:
    torch.save(weights, folder / "act.pt")
    digest = hashlib.sha256((folder / "act.pt").read_bytes()).hexdigest()
    (folder / "policy.yaml").write_text(card.replace("SHA256", digest))
    return folder


@pytest.mark.parametrize("pre_norm", [False, True])
@pytest.mark.parametrize(
    ("shapes", "maps", "reference", "size"),
    [
        (SMALL, 16, small_backbone, (45, 80)),
        (resnet18(), 512, resnet_backbone, (64, 96)),
        ({}, 0, None, None),
    ],
    ids=["small", "resnet18", "no-images"],
)
def test_forward_pass_agrees_with_numpy(pre_norm, shapes, maps, reference, size):
    weights = randomized(layout(backbone=shapes, maps=maps, pre_norm=pre_norm))
    rng = np.random.default_rng(1)
    proprio = rng.normal(size=53)
    images = rng.uniform(0, 1, (2, 3, *size)) if size else ()
    network = Act.from_tensors(weights, "act.pt", heads=HEADS)
    with torch.inference_mode():
        batch = torch.tensor(images).float() if size else None
        chunk = network(torch.tensor(proprio[None]).float(), batch)
    expected = forward(weights, reference, proprio, images, pre_norm=pre_norm)
    assert np.abs(expected).max() > 0.05
    np.testing.assert_allclose(chunk.numpy(), expected, atol=1e-5, rtol=1e-5)


def test_statistics_in_the_file_normalise_input_and_output():
    weights = randomized(layout(backbone={}, maps=0, pre_norm=False))
    rng = np.random.default_rng(2)
    for name, size in (("proprio", 53), ("action", 12)):
        weights[f"normalize.{name}.mean"] = torch.tensor(rng.normal(size=size)).float()
        weights[f"normalize.{name}.std"] = torch.tensor(rng.uniform(0.5, 2, size)).float()
    proprio = rng.normal(size=53)
    named = {f"model.{name}": tensor for name, tensor in weights.items()}
    named["model.vae_encoder_cls_embed.weight"] = torch.zeros(1, WIDTH)  # Training only.
    network = Act.from_tensors(named, "act.pt", heads=HEADS)
    chunk = network(torch.tensor(proprio[None]).float(), None)
    expected = forward(weights, None, proprio, (), pre_norm=False)
    np.testing.assert_allclose(chunk.numpy(), expected, atol=1e-5, rtol=1e-5)


def test_ensembling_weighs_the_oldest_prediction_most():
    rng = np.random.default_rng(0)
    chunks = rng.normal(size=(30, CHUNK, 12))  # chunks[t][i] is for step t + i
    queue = ChunkQueue(ensemble=0.1)
    for now in range(30):
        queue.add(chunks[now])
        action = queue.take()
        oldest = max(0, now - CHUNK + 1)
        made = np.arange(oldest, now + 1)
        weights = np.exp(-0.1 * np.arange(len(made)))
        predictions = np.array([chunks[t][now - t] for t in made])
        expected = (weights[:, None] * predictions).sum(axis=0) / weights.sum()
        np.testing.assert_allclose(action, expected, atol=1e-12)


def test_without_ensembling_a_chunk_is_played_until_the_next():
    queue = ChunkQueue(ensemble=None)
    first, second = np.arange(10.0)[:, None], np.arange(100.0, 110.0)[:, None]
    queue.add(first)
    played = [queue.take()[0] for _ in range(3)]
    queue.add(second)
    played += [queue.take()[0] for _ in range(3)]
    assert played == [0, 1, 2, 100, 101, 102]


def test_the_card_runs_and_continues_from_a_saved_state_bit_for_bit(tmp_path):
    weights = randomized(layout(backbone=SMALL, maps=16, pre_norm=False))
    card = CARD.replace("query_every: 1", "query_every: 3")
    bundle = load_bundle(save_bundle(tmp_path, weights, card))
    rng = np.random.default_rng(3)
    observations = [
        {
            "proprio": rng.normal(size=53).astype(np.float32),
            "rgb": rng.uniform(0, 1, (3, 45, 80)).astype(np.float32),
        }
        for _ in range(12)
    ]
    first = open_policy(bundle)
    first.reset(0)
    begun = [first.act(observation) for observation in observations[:5]]
    chunk = forward(
        weights,
        small_backbone,
        observations[0]["proprio"],
        [observations[0]["rgb"]],
        pre_norm=False,
    )
    np.testing.assert_allclose(begun[:3], chunk[:3], atol=1e-5, rtol=1e-5)
    state = first.state()
    rest = [first.act(observation) for observation in observations[5:]]
    second = open_policy(bundle)
    second.reset(9)
    second.restore(state)
    np.testing.assert_array_equal(rest, [second.act(o) for o in observations[5:]])


def test_the_cards_observations_are_those_that_the_network_takes(tmp_path):
    weights = randomized(layout(backbone=SMALL, maps=16, pre_norm=False))
    specs = check_bundle(load_bundle(save_bundle(tmp_path, weights)))
    assert {spec.name: spec.shape for spec in specs} == {"proprio": (53,), "rgb": (3, 45, 80)}
    blind = CARD.replace("layout: parkour53", "terms: [joint_pos, joint_vel]")
    with pytest.raises(PolicyError, match=r"`proprio` is 24 numbers; .* input `proprio` wants 53"):
        check_bundle(load_bundle(save_bundle(tmp_path, weights, blind)))


def test_faults_are_said_with_their_values(tmp_path):
    weights = randomized(layout(backbone=SMALL, maps=16, pre_norm=False))
    for card, reason in (
        (CARD.replace("heads: 4", "heads: 5"), "5 attention heads cannot share a width of 32"),
        (CARD.replace("query_every: 1", "query_every: 11"), "a chunk has only 10 actions"),
        (CARD.replace("heads: 4", "heads: 0"), "option 'heads'"),
    ):
        bundle = load_bundle(save_bundle(tmp_path, weights, card))
        with pytest.raises(PolicyError, match=reason):
            open_policy(bundle)
    seven = {"action_head.weight": torch.ones(7, 32), "action_head.bias": torch.ones(7)}
    bundle = load_bundle(save_bundle(tmp_path, weights | seven))
    with pytest.raises(PolicyError, match="has 7 actions, the robot 'go1' has 12 joints"):
        open_policy(bundle)
    policy = open_policy(load_bundle(save_bundle(tmp_path, weights)))
    policy.close()
    with pytest.raises(TrialError, match="closed"):
        policy.act({})
