"""A checkpoint of Orbax becomes one file that acts as brax' own inference.

`orbax/000000000500` was written by brax 0.14.2 (`ppo.checkpoint.save`, orbax-checkpoint 0.12.8):
PPO's parameters of 45 numbers, two layers of 8 and twelve joints. `expected.json` has four
observations and the actions that its `make_inference_fn` gave.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from nw_base.errors import PolicyError, PrerequisiteError
from nw_eval import api
from nw_policies import load_bundle, open_policy
from nw_policies.drafting.beside import find_checkpoint
from nw_policies.drafting.draft import draft_of
from nw_policies.folding import fold_orbax
from nw_policies.safety import read_tensors

SAVED = Path(__file__).parent / "orbax"
STEP = SAVED / "000000000500"


def has_tensorstore():
    return pytest.importorskip("tensorstore", reason="needs the extra orbax")


def test_the_folded_file_acts_as_brax_does(tmp_path):
    has_tensorstore()
    file = tmp_path / "policy.safetensors"
    assert api.fold_policy(STEP, out=file).bytes == file.stat().st_size
    text = draft_of(checkpoint=str(file), robot="go1", folder=str(tmp_path))["text"]
    (tmp_path / "policy.yaml").write_text(text)
    assert "  activation: silu  # policy.safetensors" in text
    bundle = load_bundle(tmp_path)
    policy = open_policy(bundle)
    policy.reset(0)
    expected = json.loads((SAVED / "expected.json").read_text())
    (name,) = bundle.card.observations
    actions = [policy.act({name: np.array(o, np.float32)}) for o in expected["observations"]]
    np.testing.assert_allclose(actions, expected["actions"], rtol=0, atol=1e-6)


def test_arrays_in_folders_of_their_own_are_the_same(tmp_path):
    tensorstore = has_tensorstore()
    whole, apart = tmp_path / "whole.safetensors", tmp_path / "apart.safetensors"
    fold_orbax(checkpoint=str(STEP), out=str(whole))
    tensors = read_tensors(whole.read_bytes(), "whole")
    for name, tensor in tensors.items():
        kvstore = {"driver": "file", "path": f"{tmp_path}/step/{name}/"}
        spec = {"driver": "zarr", "kvstore": kvstore}
        array = tensorstore.open(
            spec, create=True, dtype=str(tensor.dtype).removeprefix("torch."), shape=tensor.shape
        ).result()
        array.write(tensor.numpy()).result()
    fold_orbax(checkpoint=str(tmp_path / "step"), out=str(apart))
    again = read_tensors(apart.read_bytes(), "apart")
    assert list(again) == list(tensors)
    assert all(np.array_equal(again[name], tensor) for name, tensor in tensors.items())


def test_a_damaged_checkpoint_is_refused(tmp_path):
    has_tensorstore()
    step = Path(shutil.copytree(STEP, tmp_path / "step"))
    for file in (step / "d").iterdir():
        file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(PolicyError, match="the checkpoint is damaged"):
        fold_orbax(checkpoint=str(step), out=str(tmp_path / "out"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(PolicyError, match="no array of a checkpoint of Orbax can be read"):
        fold_orbax(checkpoint=str(tmp_path / "empty"), out=str(tmp_path / "out"))


def test_without_the_library_the_extra_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "tensorstore", None)
    with pytest.raises(PrerequisiteError, match="with the extra `orbax`"):
        fold_orbax(checkpoint=str(STEP), out=str(tmp_path / "out"))


@pytest.mark.parametrize("within", [".", "checkpoints", "checkpoints/items"])
def test_a_folder_of_steps_is_refused_with_the_newest_and_what_would_do(within, tmp_path):
    steps = tmp_path / ("run" if within == "." else "run/checkpoints")
    inner = "default" if within == "checkpoints/items" else "."
    for step in ("000000000500", "000000012000"):
        shutil.copytree(STEP, steps / step / inner)
    newest = steps / "000000012000" / inner
    where = steps if within == "checkpoints/items" else tmp_path / "run"
    with pytest.raises(PolicyError, match="is a checkpoint of Orbax") as caught:
        find_checkpoint(where)
    assert f"`nw-eval policies fold {newest} --out policy.safetensors`" in str(caught.value)
