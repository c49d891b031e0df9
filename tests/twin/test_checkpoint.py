"""Trainings on disk: the same bits after a break, and a sentence about a file that is none."""

from dataclasses import replace

import numpy as np
import pytest
from small_capture import beginning, photos
from test_trainer import BUSY

from nw_base.errors import StoreError
from nw_base.files.cache import sealed_path
from nw_base.memory import pack
from nw_splat.gaussians import ARRAYS, concatenate
from nw_twin.gaussians import trainer as training
from nw_twin.gaussians.initial import gaussians_at
from nw_twin.gaussians.trainer import Trainer, resume_training, save_training


@pytest.mark.parametrize("strategy", ["default", "mcmc"])
def test_a_training_that_was_left_goes_on_with_the_same_bits(tmp_path, strategy):
    taken, config = photos(depth=True), replace(BUSY, strategy=strategy)
    start = with_floaters(taken)
    whole = Trainer(taken, start, config)
    whole.run()
    trainer = Trainer(taken, start, config)
    for until in (13, 44):  # Between two times at which some come and go.
        trainer.run(until)
        save_training(tmp_path / "state", trainer)
        trainer = resume_training(tmp_path / "state", taken, start, config, threads=2)
        assert trainer.iteration == until
    trainer.run()
    assert trainer.is_done
    for name in ARRAYS:
        assert (getattr(trainer.gaussians, name) == getattr(whole.gaussians, name)).all()
    assert (trainer.exposures.maps == whole.exposures.maps).all()
    assert trainer.floaters == whole.floaters >= len(taken)


def with_floaters(taken):
    """Return Gaussians to begin with, a few of them before each camera."""
    ahead = [p.camera.T_world_camera @ (0.0, 0.0, z, 1.0) for p in taken for z in (0.8, 1.0, 1.2)]
    air = gaussians_at(np.array(ahead)[:, :3], np.full((3 * len(taken), 3), 0.5), opacity=0.5)
    return concatenate(beginning(degree=1), air)


@pytest.fixture
def saved(tmp_path):
    trainer = Trainer(photos(2), beginning(), BUSY)
    trainer.run(3)
    save_training(tmp_path / "state", trainer)
    return tmp_path / "state"


def test_a_file_that_is_missing_or_damaged_is_named(saved):
    with pytest.raises(StoreError, match="none: no training"):
        resume_training(saved.with_name("none"), photos(2), beginning(), BUSY)
    content = bytearray(saved.read_bytes())
    content[len(content) // 2] ^= 1
    saved.with_name("damaged").write_bytes(content)
    with pytest.raises(StoreError, match="not what was written"):
        resume_training(saved.with_name("damaged"), photos(2), beginning(), BUSY)


def test_other_photographs_another_beginning_and_other_wishes_are_noticed(saved):
    other = photos(2)
    other[1].rgb[0, 0, 0] ^= 1
    masked = [replace(photo, mask=np.ones((48, 72), dtype=bool)) for photo in photos(2)]
    whole = beginning()
    wishes = [(taken, whole, BUSY) for taken in (photos(3), other, masked)]
    wishes.append((photos(2), whole, replace(BUSY, seed=5)))
    wishes.append((photos(2), whole, replace(BUSY, projection="ewa")))
    wishes.append((photos(2), replace(whole, means=whole.means + np.float32(0.01)), BUSY))
    for taken, start, config in wishes:
        with pytest.raises(StoreError, match="other photographs, another mesh or other"):
            resume_training(saved, taken, start, config)


def test_a_training_of_another_version_is_begun_anew(saved, monkeypatch):
    monkeypatch.setattr(training, "FORMAT", training.FORMAT + 1)
    with pytest.raises(StoreError, match="start a new one"):
        resume_training(saved, photos(2), beginning(), BUSY)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("mean.quats", np.zeros((3, 4), dtype=np.float32)),
        ("values.sh", np.zeros((700, 2, 3), dtype=np.float32)),
        ("exposure.maps", np.zeros((2, 3, 4))),
        ("density.views", None),
        ("iteration", np.array(10**9)),
        ("iteration", np.array([1, 2])),
    ],
)
def test_arrays_that_do_not_belong_together_are_refused(saved, monkeypatch, name, array):
    from nw_twin.gaussians import trainer as checkpoint

    def tampered(arrays):
        changed = {key: value for key, value in arrays.items() if key != name}
        return pack(changed if array is None else changed | {name: array})

    monkeypatch.setattr(checkpoint, "pack", tampered)
    trainer = Trainer(photos(2), beginning(), BUSY)
    save_training(saved, trainer)
    with pytest.raises(StoreError, match="missing or do not belong together"):
        resume_training(saved, photos(2), beginning(), BUSY)


def test_bytes_that_hold_no_arrays_are_refused(tmp_path):
    with sealed_path(tmp_path / "state") as path:
        path.write_bytes(b"\x05\0\0\0[[[[[")
    with pytest.raises(StoreError, match="no training to resume"):
        resume_training(tmp_path / "state", photos(2), beginning(), BUSY)
