"""A model of Stable-Baselines3 acts with the statistics that its `VecNormalize` saved beside it.

`vecnormalize/vecnormalize.pkl` is of `VecNormalize.save`, after 512 steps of a PPO training on
random observations, `clip_obs` 3; `expected.json` has four observations and the actions that
`PPO.load(trained/sb3/best_model.zip).predict(VecNormalize.load(...).normalize_obs(obs))` gave.
"""

import json
import pickle  # noqa: TID251 - it writes what must not be executed.
import shutil
from pathlib import Path

import numpy as np
import pytest

from nw_base.errors import PolicyError
from nw_policies import load_bundle, open_policy
from nw_policies.drafting.draft import draft_of
from nw_policies.drafting.trained import read_statistics, statistics_beside

SAVED = Path(__file__).parent / "vecnormalize"
MODEL = Path(__file__).parent / "trained" / "sb3" / "best_model.zip"
EXPECTED = json.loads((SAVED / "expected.json").read_text())


@pytest.fixture
def folder(tmp_path):
    shutil.copy(MODEL, tmp_path)
    shutil.copy(SAVED / "vecnormalize.pkl", tmp_path)
    return tmp_path


def drafted(folder: Path) -> str:
    model = folder / "best_model.zip"
    found = statistics_beside(model)
    return draft_of(
        checkpoint=str(model),
        robot="go1",
        folder=str(folder),
        statistics=None if found is None else str(found),
    )["text"]


def actions_of(folder: Path) -> np.ndarray:
    bundle = load_bundle(folder)
    policy = open_policy(bundle)
    policy.reset(0)
    (name,) = bundle.card.observations
    seen = EXPECTED["observations"]
    return np.array([policy.act({name: np.array(one, np.float32)}) for one in seen])


def test_the_drafted_card_acts_as_stable_baselines3_does(folder):
    text = drafted(folder)
    (folder / "policy.yaml").write_text(text)
    np.testing.assert_allclose(actions_of(folder), EXPECTED["actions"], rtol=0, atol=1e-6)
    assert "eps: 0.00000001, eps_in: variance, clip: 3}  # vecnormalize.pkl" in text
    (folder / "vecnormalize.pkl").unlink()
    (folder / "policy.yaml").write_text(drafted(folder))
    assert np.abs(actions_of(folder) - EXPECTED["actions"]).max() > 1e-3, "they matter"


def test_it_acts_as_an_installed_stable_baselines3(folder):
    sb3 = pytest.importorskip("stable_baselines3")
    spaces = pytest.importorskip("gymnasium").spaces
    from stable_baselines3.common.vec_env import VecNormalize

    (folder / "policy.yaml").write_text(drafted(folder))
    with (folder / "vecnormalize.pkl").open("rb") as stream:
        normalise: VecNormalize = pickle.load(stream)
    assert isinstance(normalise.observation_space, spaces.Box)
    model = sb3.PPO.load(MODEL)
    seen = np.array(EXPECTED["observations"], np.float32)
    want = [model.predict(normalise.normalize_obs(o[None]), deterministic=True)[0][0] for o in seen]
    np.testing.assert_allclose(actions_of(folder), want, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("model", "statistics"),
    [
        ("best_model.zip", "vecnormalize.pkl"),  # rl_zoo3, beside it or in a folder.
        ("best_model.zip", "Go1-v0/vecnormalize.pkl"),
        ("best/best_model.zip", "vec_normalize.pkl"),
        ("rl_model_2000_steps.zip", "rl_model_vecnormalize_2000_steps.pkl"),  # CheckpointCallback.
        ("model.zip", "model_vecnormalize.pkl"),  # Isaac Lab.
    ],
)
def test_statistics_are_found_where_trainings_save_them(tmp_path, model, statistics):
    for name in (model, statistics, "rl_model_vecnormalize_1000_steps.pkl", "replay_buffer.pkl"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert statistics_beside(tmp_path / model) == tmp_path / statistics


class Calls:
    def __reduce__(self):
        return print, ("executed",)


def test_no_call_of_the_file_is_made(tmp_path, capfd):
    path = tmp_path / "vecnormalize.pkl"
    path.write_bytes(pickle.dumps({"obs_rms": Calls()}))
    with pytest.raises(PolicyError, match=r"asks to call 'builtins\.print'"):
        read_statistics(path, 45)
    assert "executed" not in capfd.readouterr().out


def test_statistics_of_another_size_or_of_nothing_are_refused(tmp_path):
    with pytest.raises(PolicyError, match="it is about 45 numbers, the model takes 48"):
        read_statistics(SAVED / "vecnormalize.pkl", 48)
    path = tmp_path / "vecnormalize.pkl"
    path.write_bytes(pickle.dumps({"mean": [1.0]}))
    with pytest.raises(PolicyError, match="has no statistics of observations, no `VecNormalize`"):
        read_statistics(path, 45)
