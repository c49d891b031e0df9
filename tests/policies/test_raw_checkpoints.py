"""Every entry of a training's file is used by the card, passed over with a reason, or named."""

import io
import json
import os
import re
import zipfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from nw_base.errors import PolicyError
from nw_policies import load_bundle, open_policy
from nw_policies.drafting.draft import draft_of
from nw_policies.drafting.feeders import files_beside
from nw_policies.drafting.trained import _PASSED_OVER

SEEN = np.random.default_rng(1).normal(size=(4, 45)).astype(np.float32) * 2


def layers(sizes, prefix, step=2):
    """Return the tensors of linear layers, numbered with gaps of `step`."""
    generator = torch.Generator().manual_seed(len(prefix))
    state = {}
    for place, (one, other) in enumerate(pairwise(sizes)):
        state[f"{prefix}{place * step}.weight"] = torch.randn(other, one, generator=generator) * 0.2
        state[f"{prefix}{place * step}.bias"] = torch.randn(other, generator=generator) * 0.2
    return state


def run(state, prefix, x, activation, count=2):
    for place in range(count):
        x = x @ state[f"{prefix}{2 * place}.weight"].T + state[f"{prefix}{2 * place}.bias"]
        x = activation(x) if place < count - 1 else x
    return x


def draft(path, tree) -> str:
    torch.save(tree, path)
    return card(path)


def card(path) -> str:
    text = draft_of(checkpoint=str(path), robot="go1", folder=str(path.parent))["text"]
    (path.parent / "policy.yaml").write_text(text)
    return text


def acted(folder, seen=SEEN):
    bundle = load_bundle(folder)
    policy = open_policy(bundle)
    policy.reset(0)
    (name,) = bundle.card.observations
    actions = np.array([policy.act({name: row}) for row in seen])
    clip = bundle.card.control.clip
    return actions if clip is None else np.clip(actions, *clip)


def rsl_rl():
    state = {**layers([45, 16, 12], "actor."), **layers([45, 8, 1], "critic.")}
    mean, deviation = torch.linspace(-1, 1, 45)[None], torch.linspace(0.5, 3, 45)[None]
    for who in ("actor", "critic"):
        state |= {
            f"{who}_obs_normalizer._mean": mean,
            f"{who}_obs_normalizer._var": deviation**2,
            f"{who}_obs_normalizer._std": deviation,
            f"{who}_obs_normalizer.count": torch.tensor(9),
        }
    return {**state, "std": torch.ones(12)}


def wrapped(state, how):
    inner = {"layer": "actor.0.", "part": "actor."}.get(how)
    if inner is None:
        return {f"{how}{name}": tensor for name, tensor in state.items()}
    return {name.replace(inner, f"{inner}_orig_mod."): t for name, t in state.items()}


@pytest.mark.parametrize(
    "how", ["module.", "_orig_mod.", "module._orig_mod.", "_orig_mod.module.", "part", "layer", ""]
)
def test_a_wrapped_policy_keeps_its_normaliser(how, tmp_path):
    state = rsl_rl()
    text = draft(
        tmp_path / "model_9.pt",
        {"model_state_dict": wrapped(state, how), "iter": 9, "infos": None},
    )
    assert "normaliser: {mean: model_state_dict.actor_obs_normalizer._mean" in text
    assert "does not use" not in text
    x = (torch.tensor(SEEN) - state["actor_obs_normalizer._mean"]) / (
        state["actor_obs_normalizer._std"] + 0.01
    )
    want = run(state, "actor.", x, torch.nn.functional.elu)
    np.testing.assert_allclose(acted(tmp_path), want, atol=1e-6)


def test_a_compiled_policy_of_rl_games_is_no_unknown_network(tmp_path):
    state = {
        **layers([45, 16], "a2c_network.actor_mlp."),
        "a2c_network.mu.weight": torch.ones(12, 16) / 40,
        "a2c_network.mu.bias": torch.zeros(12),
        "a2c_network.sigma": torch.zeros(12),
        "running_mean_std.running_mean": torch.zeros(45),
        "running_mean_std.running_var": torch.ones(45) * 4,
        "running_mean_std.count": torch.ones(()),
        "value_mean_std.running_mean": torch.ones(1),
    }
    model = {f"_orig_mod.{name}": tensor for name, tensor in state.items()}
    text = draft(tmp_path / "Go1.pth", {"model": model, "epoch": 3, "frame": 4})
    assert "variance: model.running_mean_std.running_var" in text
    assert "does not use" not in text
    assert acted(tmp_path).shape == (4, 12)


def cleanrl(last="fc_mu", root=""):
    state = {}
    for name, (one, other) in {"fc1": (45, 16), "fc2": (16, 16), last: (16, 12)}.items():
        part = layers([one, other], name)
        state |= {f"{root}{key.replace(f'{name}0', name)}": value for key, value in part.items()}
    return state


@pytest.mark.parametrize("last", ["fc_mean", "fc_mu"])
@pytest.mark.parametrize("kind", ["dict", "tuple"])
def test_the_scale_and_bias_of_cleanrl_are_used(last, kind, tmp_path):
    state = cleanrl(last)
    state |= {"action_scale": torch.linspace(0.1, 3, 12), "action_bias": torch.linspace(-1, 1, 12)}
    critic = layers([57, 8, 1], "fc")
    tree = state if kind == "dict" else (state, critic, critic)
    text = draft(tmp_path / "sac.cleanrl_model", tree)
    x = torch.tensor(SEEN)
    for name in ("fc1", "fc2", last):
        x = x @ state[f"{name}.weight"].T + state[f"{name}.bias"]
        x = x if name == last else torch.relu(x)
    want = torch.tanh(x) * state["action_scale"] + state["action_bias"]
    np.testing.assert_allclose(acted(tmp_path), want, atol=1e-6)
    root = "" if kind == "dict" else "0."
    assert f"output_scale: {json.dumps(f'{root}action_scale') if root else 'action_scale'}" in text


def test_one_scale_and_bias_are_those_of_all_joints(tmp_path):
    state = {**cleanrl(), "action_scale": torch.ones(1) * 2, "action_bias": torch.tensor(0.5)}
    draft(tmp_path / "td3.pt", state)
    assert np.abs(acted(tmp_path) - 0.5).max() <= 2
    assert np.abs(acted(tmp_path) - 0.5).max() > 0.9


def test_averaged_weights_are_not_taken_for_the_policy(tmp_path):
    text = draft(tmp_path / "m.pt", {"model_state_dict": rsl_rl(), "ema_state_dict": rsl_rl()})
    assert "weights: model_state_dict.actor" in text
    assert "other networks: ema_state_dict.actor" in text


def test_limits_that_no_file_says_are_to_be_checked(tmp_path):
    text = draft(tmp_path / "td3.pt", cleanrl())
    assert "CHECK: the limits of its actions are not in the file: -1 and 1 are assumed" in text


def sb3(path, state, data):
    buffer = io.BytesIO()
    torch.save(state, buffer)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("policy.pth", buffer.getvalue())
        archive.writestr("data", json.dumps(data))
    return card(path)


def space(low, high):
    return {"action_space": {"low": str(np.array(low)), "high": str(np.array(high))}}


def td3():
    state = layers([45, 16, 12], "actor.mu.")
    target = {name.replace("actor.", "actor_target."): t for name, t in state.items()}
    return {**state, **target, **layers([57, 8, 1], "critic.qf0.")}


LOW, HIGH = -np.linspace(1, 2, 12).astype("f4"), np.linspace(0.5, 3, 12).astype("f4")


@pytest.mark.parametrize("limits", [(LOW, HIGH), (np.full(12, -2.0), np.full(12, 2.0))])
def test_the_limits_of_the_action_space_are_used(limits, tmp_path):
    state, (low, high) = td3(), limits
    text = sb3(tmp_path / "best_model.zip", state, {**space(low, high), "policy_kwargs": {}})
    raw = torch.tanh(run(state, "actor.mu.", torch.tensor(SEEN), torch.relu)).numpy()
    np.testing.assert_allclose(acted(tmp_path), low + (raw + 1) / 2 * (high - low), atol=1e-6)
    assert "Stable-Baselines3 (TD3)" in text


def ppo():
    state = layers([45, 16], "mlp_extractor.policy_net.")
    state |= {"action_net.weight": torch.ones(12, 16) / 9, "action_net.bias": torch.zeros(12)}
    return {**state, "log_std": torch.zeros(12), "value_net.bias": torch.zeros(1)}


def test_what_ppo_clips_is_clipped_or_said(tmp_path):
    limits = space([-0.1] * 12, [0.2] * 12)
    text = sb3(tmp_path / "best_model.zip", ppo(), {**limits, "policy_kwargs": {}})
    assert "  clip: [-0.1, 0.2]" in text
    assert acted(tmp_path).min() >= -0.1
    text = sb3(tmp_path / "best_model.zip", ppo(), {**space(LOW, HIGH), "policy_kwargs": {}})
    assert "CHECK: the trainer clips actions, each joint's by itself" in text


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({}, "`action_space` of the zip is absent"),
        (space([np.nan] * 12, [1] * 12), "`action_space` of the zip is"),
        (space([-1] * 11, [1] * 11), "`action_space` of the zip is"),
        (space([-np.inf] * 12, [np.inf] * 12), "`action_space` of the zip is"),
        ({"policy_kwargs": {"zz_mark": 3}}, "that the card does not: policy_kwargs.zz_mark"),
        ({"policy_kwargs": {"activation_fn": "<class 'own.Sine'>"}}, "activation_fn <class 'own"),
    ],
)  # fmt: skip
def test_settings_of_stable_baselines3_are_used_or_named(data, said, tmp_path):
    data = {**space([-1] * 12, [1] * 12), **data} if "policy_kwargs" in data else data
    assert said in sb3(tmp_path / "best_model.zip", td3(), data)


def test_an_actor_that_is_only_a_part_of_the_file_is_refused(tmp_path):
    normed = {"actor.latent_pi.0.scale": torch.ones(45), **layers([45, 16], "actor.latent_pi.1")}
    state = {**normed, "actor.mu.weight": torch.ones(12, 16), "actor.mu.bias": torch.zeros(12)}
    with pytest.raises(PolicyError, match=r"unknown network: actor\.latent_pi"):
        draft(tmp_path / "crossq.pt", state)


def test_layers_behind_a_recurrent_one_are_not_the_whole_actor(tmp_path):
    state = {"lstm.weight_ih_l0": torch.ones(64, 45), "lstm.weight_hh_l0": torch.ones(64, 16)}
    state |= {**layers([16, 16], "net_container."), "policy_layer.weight": torch.ones(12, 16)}
    with pytest.raises(PolicyError, match="unknown network"):
        draft(tmp_path / "agent.pt", {"policy": state})


def tianshou(last):
    state = layers([45, 16, 16], "actor.preprocess.model.model.")
    state |= layers([16, 12], f"actor.{last}.model.")
    return {**state, "actor.sigma_param": torch.zeros(12, 1), **layers([45, 8, 1], "critic.last.")}


@pytest.mark.parametrize(
    ("state", "parts", "activation"),
    [
        (tianshou("mu"), ("actor.preprocess.model.model.", "actor.mu.model."), torch.relu),
        (tianshou("last"), ("actor.preprocess.model.model.", "actor.last.model."), torch.relu),
        (layers([45, 16, 24], "module.0.module.0."), ("module.0.module.0.",), torch.tanh),
    ],
    ids=["tianshou", "tianshou, deterministic", "TorchRL"],
)
def test_actors_of_other_libraries_are_whole(state, parts, activation, tmp_path):
    text = draft(tmp_path / "actor.pt", state)
    x = torch.tensor(SEEN)
    for place, part in enumerate(parts):
        x = run(state, part, x, activation, count=2 if place == 0 else 1)
        x = activation(x) if place < len(parts) - 1 else x
    np.testing.assert_allclose(acted(tmp_path), torch.tanh(x[:, :12]), atol=1e-6)
    assert "-1 and 1 are assumed" in text


OTHER = {
    "skip.weight": torch.ones(7, 45),
    "zz_matrix": torch.ones(3, 4),
    "obs_rms.mean": torch.ones(45),
    "obs_rms.std": torch.ones(45),
    "action_offset": torch.ones(12),
    "state_normalizer.running_var": torch.ones(45),
}


@pytest.mark.parametrize("name", OTHER)
@pytest.mark.parametrize("place", ["", "model_state_dict."])
def test_a_tensor_that_nothing_reads_is_named(name, place, tmp_path):
    inside = {**rsl_rl(), **({name: OTHER[name]} if place else {})}
    tree = {"model_state_dict": inside, **({} if place else {name: OTHER[name]})}
    text = draft(tmp_path / "model_9.pt", tree)
    rare = "does not use" if re.search("norm|rms|offset", name) else "has other networks"
    (line,) = [line for line in text.splitlines() if rare in line]
    assert "CHECK" in line
    assert f"{place}{name}".removesuffix(".weight") in line


@pytest.mark.parametrize("value", [3.0, "text", [1, 2], (1, "a"), True, np.float64(2)])
def test_an_entry_that_is_no_tensor_is_named_or_passed_over(value, tmp_path):
    tree = {"model_state_dict": rsl_rl(), "zz_mark": value, "iter": 9, "optimizer": {"lr": 0.1}}
    text = draft(tmp_path / "model_9.pt", tree)
    assert "the card does not use these entries of the file: zz_mark" in text
    assert "iter," not in text
    assert "lr" not in text


def test_each_reason_to_pass_over_has_names_of_its_own():
    names = {
        "it judges the policy or teaches it, and does not act": "critic.0.weight",
        "it is the state of a training": "optimizer_state_dict.lr",
        "it says how widely a training draws actions": "log_std",
        "it counts what was seen": "obs.count",
    }
    for reason, name in names.items():
        found = {why for why, rule in _PASSED_OVER.items() if re.search(rule, name)}
        assert found == {reason}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"actor.0.bias": torch.full((16,), torch.nan)}, r"actor\.0\.bias' has NaN or infinite"),
        ({"actor_obs_normalizer._mean": torch.full((1, 45), torch.inf)}, "has NaN or infinite"),
        ({"actor_obs_normalizer._std": torch.full((1, 45), -1.0)}, "not above 0"),
        ({"actor_obs_normalizer._std": torch.ones(1, 44)}, "has 44 numbers"),
    ],
)
def test_numbers_that_are_none_are_refused_by_name(change, said, tmp_path):
    draft(tmp_path / "model_9.pt", {"model_state_dict": {**rsl_rl(), **change}})
    with pytest.raises(PolicyError, match=said):
        acted(tmp_path)


@pytest.mark.parametrize("given", ["[1, .nan, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]", "[1, 2]", "missing"])
def test_an_output_scale_that_does_not_fit_is_refused(given, tmp_path):
    text = draft(tmp_path / "model_9.pt", {"model_state_dict": rsl_rl()})
    text = text.replace("  normaliser:", f"  output_scale: {given}\n  normaliser:")
    (tmp_path / "policy.yaml").write_text(text)
    with pytest.raises(PolicyError, match=r"output_scale|'missing'"):
        acted(tmp_path)


@pytest.mark.parametrize(("norm", "runs"), [(torch.nn.LayerNorm, True), (torch.nn.RMSNorm, False)])
def test_a_normalisation_that_the_file_does_not_tell_is_refused(norm, runs, tmp_path):
    module = torch.nn.Sequential(
        torch.nn.Linear(45, 16), norm(16), torch.nn.ELU(), torch.nn.Linear(16, 12)
    )
    tree = {"model_state_dict": {f"actor.{k}": v for k, v in module.state_dict().items()}}
    if runs:
        draft(tmp_path / "model_9.pt", tree)
        np.testing.assert_allclose(acted(tmp_path), module(torch.tensor(SEEN)).detach(), atol=1e-6)
    else:
        with pytest.raises(PolicyError, match="weights of an unknown network"):
            draft(tmp_path / "model_9.pt", tree)


def test_another_export_of_the_policy_is_not_offered_as_its_estimator(tmp_path):
    module = torch.nn.Sequential(torch.nn.Linear(45, 16), torch.nn.ELU(), torch.nn.Linear(16, 12))
    torch.jit.script(module).save(str(tmp_path / "policy.pt"))
    torch.save({"model_state_dict": module.state_dict()}, tmp_path / "model_1500.pt")
    example = (torch.zeros(1, 45),)
    torch.jit.trace(module, example).save(str(tmp_path / "jit_export.jit"))
    other = torch.nn.Linear(45, 3)
    torch.jit.script(other).save(str(tmp_path / "estimator.pt"))
    offered = files_beside(tmp_path / "policy.pt")
    assert "estimator:" in offered
    assert "model_1500" not in offered
    assert "jit_export" not in offered


ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", Path(__file__).parents[3] / "shared/assets"))
THIRD = ASSETS / "found/third/networks"


@pytest.mark.skipif(not THIRD.exists(), reason="the files of others are not here")
@pytest.mark.parametrize("name", ["cleanrl_sac_scaled", "cleanrl_td3", "torchrl"])
def test_files_of_libraries_act_as_the_libraries_themselves(name, tmp_path):
    (file,) = [p for p in (THIRD / name).iterdir() if p.suffix in {".pt", ".cleanrl_model"}]
    (tmp_path / file.name).write_bytes(file.read_bytes())
    card(tmp_path / file.name)
    with np.load(THIRD / name / "ref.npz") as reference:
        np.testing.assert_allclose(acted(tmp_path, reference["O"]), reference["A"], atol=1e-6)
