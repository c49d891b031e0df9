"""A card's `runtime: nw-eval` runs the same networks: in the trial's process, from checked data."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import nw_eval
from nw_eval.errors import PolicyError
from nw_eval.policies import load_bundle, open_policy

POLICIES = Path(nw_eval.__file__).parents[2] / "policies"


@pytest.fixture
def card(tmp_path):
    """Return a copy of a shipped policy that nw-eval runs."""

    def make(name, extra="runtime: nw-eval"):
        folder = Path(shutil.copytree(POLICIES / name, tmp_path / name))
        text = (folder / "policy.yaml").read_text(encoding="utf-8")
        (folder / "policy.yaml").write_text(
            text.replace("adapter: onnx\n", f"adapter: onnx\n{extra}\n", 1)
        )
        return load_bundle(folder)

    return make


def observed(bundle, seed):
    """Return random numbers for the observations that make a card's one input."""
    (spec,) = open_policy(load_bundle(POLICIES / bundle.name)).inputs
    whole = np.random.default_rng(seed).standard_normal(spec.shape[-1]).astype(np.float32)
    ((_, names),) = bundle.card.input_parts()
    return dict(zip(names, np.array_split(whole, len(names)), strict=True))


def test_actions_are_those_of_onnxruntime_to_its_rounding(card):
    bundle = card("go1-parkour")
    native, ours = open_policy(load_bundle(POLICIES / "go1-parkour")), open_policy(bundle)
    for seed in range(5):
        observation = observed(bundle, seed)
        np.testing.assert_allclose(
            ours.act(observation), native.act(observation), rtol=1e-4, atol=1e-5
        )


def test_the_runtime_counts_for_the_digest_and_not_for_what_is_computed(card):
    native, ours = load_bundle(POLICIES / "go1-parkour"), card("go1-parkour")
    assert native.digest != ours.digest
    assert native.computes == ours.computes


def test_a_card_of_another_adapter_has_no_such_runtime(card):
    file = card("go1-parkour").folder / "policy.yaml"
    file.write_text(
        file.read_text(encoding="utf-8").replace("adapter: onnx", "adapter: torchscript")
    )
    with pytest.raises(PolicyError, match="`runtime: nw-eval` runs ONNX files, not adapter"):
        load_bundle(file.parent)
