"""A training's folder: whole at any time, and harmless whoever made it."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nw_base.errors import StoreError, UsageError
from nw_learn.folder import TrainFolder


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "given.yaml").write_text("nw-train: 1\n")
    return TrainFolder.begin(tmp_path / "run", tmp_path / "given.yaml")


def test_what_was_saved_comes_back_generators_and_all(folder):
    generator = np.random.default_rng(3)
    generator.random(5)
    folder.save_state(
        {"step": 12, "w": torch.arange(3.0), "rng": generator.bit_generator.state, "on": True}
    )
    state = folder.load_state()
    again = np.random.default_rng()
    again.bit_generator.state = state["rng"]
    assert again.random() == generator.random()
    assert (state["step"], state["w"].tolist(), state["on"]) == (12, [0.0, 1.0, 2.0], True)


def test_a_folder_without_a_state_has_none_and_one_without_a_config_is_not_a_training(
    folder, tmp_path
):
    assert TrainFolder.resume(folder.path).load_state() is None
    with pytest.raises(UsageError, match="no training in"):
        TrainFolder.resume(tmp_path / "elsewhere")


def test_a_training_never_begins_over_another(folder, tmp_path):
    with pytest.raises(UsageError, match=r"holds a training already; .*--resume"):
        TrainFolder.begin(folder.path, tmp_path / "given.yaml")


def test_a_state_with_code_in_it_is_refused_and_runs_nothing(folder, tmp_path):
    class Bomb:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    for is_zip in (True, False):
        torch.save({"a": Bomb()}, folder.state, _use_new_zipfile_serialization=is_zip)
        with pytest.raises(StoreError, match="is not a training state"):
            folder.load_state()
        assert not (tmp_path / "ran").exists()


def test_a_state_that_is_cut_short_is_an_error_on_one_line(folder):
    folder.save_state({"w": torch.zeros(1000)})
    folder.state.write_bytes(folder.state.read_bytes()[:900])
    with pytest.raises(StoreError) as caught:
        folder.load_state()
    assert len(str(caught.value).splitlines()) == 1


def test_no_state_is_read_through_a_link_out_of_the_folder(folder, tmp_path):
    torch.save({"step": 1}, tmp_path / "foreign.pt")
    folder.state.symlink_to(tmp_path / "foreign.pt")
    with pytest.raises(StoreError, match="link out of its folder"):
        folder.load_state()


def test_checkpoints_beyond_a_step_are_forgotten(folder):
    for number in (1, 2, 3, 10_000):
        folder.keep(number, {"step": number})
    (folder.path / "checkpoints" / "mine.pt").touch()
    assert [path.stem for path in folder.checkpoints] == ["0001", "0002", "0003", "10000"]
    folder.forget_after(2)
    assert [path.stem for path in folder.checkpoints] == ["0001", "0002"]
