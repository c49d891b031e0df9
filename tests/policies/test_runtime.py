"""A card's `runtime: nw-eval` runs the same networks: in the trial's process, from checked data."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import adapters
import numpy as np
import pytest

import nw_eval
from nw_base.errors import PolicyError, TrialError
from nw_policies import load_bundle, open_policy
from nw_policies.bundle import PlannedFile
from nw_policies.line import line_to, trusting
from nw_policies.planned import packed, read_planned
from nw_policies.planning import plan_policy
from nw_sim.rollout.confined.access import policy_rules
from nw_sim.rollout.confined.start import PolicyProcess
from nw_sim.rollout.confined.vetting import check_bundle, vet_bundle

POLICIES = Path(nw_eval.__file__).parents[2] / "policies"
MASKS = {
    "AVX2 and FMA": {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma,+f16c"},
    "Zen 3": {
        "NUMBA_CPU_NAME": "znver3",
        "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma,+f16c,+bmi,+bmi2",
        "NPY_DISABLE_CPU_FEATURES": "X86_V4",
        "OPENBLAS_CORETYPE": "Haswell",
    },
    "SSE4 without FMA": {"NUMBA_CPU_NAME": "nehalem", "NUMBA_CPU_FEATURES": "+sse4.2"},
}
LIBRARIES = {"ATEN_CPU_CAPABILITY": "default", "ONEDNN_MAX_CPU_ISA": "SSE41", "MKL_CBWR": "SSE4_2"}
"""By which torch chooses other kernels: what it records must not depend on them."""


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
    unsaid, ours = load_bundle(POLICIES / "go1-parkour"), card("go1-parkour")
    native = replace(ours, card=ours.card.model_copy(update={"runtime": "native"}))
    assert unsaid.digest == ours.digest != native.digest
    assert unsaid.computes == native.computes
    # Where nw-eval lacks an operator, the card says the same as ever.
    assert replace(native, operator="operator CumSum").digest == unsaid.digest


@pytest.mark.parametrize("name", adapters.CARDS)
def test_every_adapter_acts_as_its_own_runtime_does_to_its_rounding(name, tmp_path):
    ours = adapters.write(tmp_path / "ours", name)
    native = adapters.write(tmp_path / "native", name, runtime="native")
    seen = adapters.observations(ours)
    expected = adapters.actions(native, seen)
    largest = np.abs(expected).max()
    np.testing.assert_allclose(adapters.actions(ours, seen), expected, rtol=0, atol=1e-5 * largest)


@pytest.mark.parametrize("name", ["student", "act", "mlp", "fed", "export"])
def test_a_policy_goes_on_from_its_state_bit_for_bit_and_begins_anew_when_reset(name, tmp_path):
    seen = adapters.observations(adapters.write(tmp_path, name), steps=9)
    bundle = load_bundle(tmp_path / name)
    with trusting():
        first, second = open_policy(bundle), open_policy(bundle)
        first.reset(0)
        before = [first.act(each) for each in seen[:4]]
        state = first.state()
        rest = [first.act(each) for each in seen[4:]]
        second.restore(state)
        np.testing.assert_array_equal([second.act(each) for each in seen[4:]], rest)
        first.reset(1)
        np.testing.assert_array_equal([first.act(each) for each in seen[:4]], before)
        second.restore(b"")
        np.testing.assert_array_equal(second.act(seen[0]), before[0])
        with pytest.raises(TrialError, match="does not fit"):
            second.restore(b"\x02\x00\x00\x00[]")
        first.close()
        with pytest.raises(TrialError, match="closed"):
            first.act(seen[0])


@pytest.mark.parametrize("name", ["script", "act"])
def test_a_file_is_read_in_the_policy_s_process_and_runs_here(name, tmp_path):
    folder = adapters.write(tmp_path, name)
    seen = adapters.observations(folder, steps=3)
    bundle = load_bundle(folder)
    with PolicyProcess(policy_rules(bundle)) as process, line_to(process.line):
        policy = open_policy(bundle)
        policy.reset(0)
        first = policy.act(seen[0])
        process.line.close()
        # What is left of it is data: no question goes to that process any more.
        actions = [first, policy.act(seen[1]), policy.act(seen[2])]
    np.testing.assert_array_equal(actions, adapters.actions(folder, seen))


@pytest.mark.parametrize("name", ["script", "export", "student"])
def test_a_file_is_vetted_behind_the_fence(name, tmp_path):
    bundle = load_bundle(adapters.write(tmp_path, name))
    assert vet_bundle(bundle, "go1").digest == bundle.digest


def test_plans_travel_as_bytes_and_damaged_ones_are_refused():
    file = PlannedFile(inputs=(), parts=(), first={"h": np.ones((1, 2), np.float32)})
    found = read_planned(packed({"": file}))[""]
    assert (found.inputs, found.parts) == ((), ())
    np.testing.assert_array_equal(found.first["h"], file.first["h"])
    for damaged in (b"", b"\x02\x00\x00\x00[]", packed({})[:-1]):
        with pytest.raises(ValueError, match=r"\w"):
            read_planned(damaged)


def test_damage_anywhere_in_a_plan_is_refused_or_leaves_a_plan_that_runs(tmp_path):
    bundle = load_bundle(adapters.write(tmp_path, "act"))
    seen = adapters.observations(bundle.folder, steps=1)[0]
    native = bundle.card.model_copy(update={"runtime": "native"})
    data = packed(plan_policy(open_policy(replace(bundle, card=native)), seen))
    rng = np.random.default_rng(8)
    head = int.from_bytes(data[:4], "little")
    refused = 0
    for _ in range(300):
        damaged = bytearray(data)
        place = rng.integers(4 + head) if rng.random() < 0.5 else len(data) - rng.integers(1, 900)
        damaged[place] = rng.integers(256)
        try:
            read_planned(bytes(damaged))
        except ValueError:
            refused += 1
    assert 150 < refused <= 300


def test_an_operator_that_is_not_run_is_an_error_that_names_it_before_any_trial(tmp_path):
    import torch

    class Sorting(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return torch.sort(x)[0][:, :12]

    folder = adapters.write(tmp_path, "script")
    torch.jit.script(Sorting()).save(folder / "policy.pt")
    reason = "`runtime: nw-eval` does not run it: operator sort; write `runtime: native`, or export"
    with trusting(), pytest.raises(PolicyError, match=reason):
        check_bundle(load_bundle(folder))


@pytest.mark.parametrize("adapter", ["remote", "python:mine:Policy"])
def test_what_is_computed_elsewhere_has_no_such_runtime(adapter, card):
    file = card("go1-parkour").folder / "policy.yaml"
    text = file.read_text(encoding="utf-8").replace("adapter: onnx", f"adapter: {adapter}")
    checkpoint = text[text.index("checkpoint:") : text.index("\ncontrol:")]
    file.write_text(text.replace(checkpoint, ""))
    with pytest.raises(PolicyError, match="`runtime: nw-eval` runs networks in files, not"):
        load_bundle(file.parent)


def test_an_onnx_policy_needs_neither_onnxruntime_nor_torch(card):
    folder = card("go1-act-depth").folder
    code = f"""
import sys
sys.modules["onnxruntime"] = sys.modules["torch"] = None
from nw_policies import load_bundle, open_policy
open_policy(load_bundle({str(folder)!r})).reset(0)
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def digests(folder, mask):
    """Return what the bundles in a folder do, in a process with other features."""
    done = subprocess.run(
        [sys.executable, adapters.__file__, str(folder)],
        env={**os.environ, **mask},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def bundles(tmp_path_factory):
    """A folder with a bundle of each adapter."""
    folder = tmp_path_factory.mktemp("adapters")
    for name in adapters.CARDS:
        adapters.write(folder, name)
    return folder


@pytest.mark.parametrize(
    "mask",
    [
        "AVX2 and FMA",
        pytest.param("Zen 3", marks=pytest.mark.nightly),
        pytest.param("SSE4 without FMA", marks=pytest.mark.nightly),
    ],
)
def test_every_adapter_gives_the_same_bits_on_other_processors(mask, bundles):
    native = digests(bundles, {})
    assert len(native) == len(adapters.CARDS)
    assert digests(bundles, {**MASKS[mask], **LIBRARIES}) == native
