"""What students learn from: trajectories in files, and samples drawn from them."""

import numpy as np
import pytest

from nw_base.errors import StoreError
from nw_learn.student.trajectory import Dataset, Trajectory, read_trajectory


def trajectory(number, *, frames=3, every=2):
    """A trajectory whose numbers say where they are from: `number`, then the step or the image."""
    steps = frames * every
    count = np.arange(steps, dtype=np.float32)
    images = 10 * number + np.arange(frames, dtype=np.uint8)
    return Trajectory(
        body=np.stack([np.full(steps, number, np.float32), count], axis=1),
        labels=np.repeat(100.0 * number + count, 12).reshape(steps, 12).astype(np.float32),
        frame_of=np.repeat(np.arange(frames), every).astype(np.int32),
        rgb=np.broadcast_to(images[:, None, None, None], (frames, 3, 2, 2)).copy(),
        depth=np.empty((0, 0, 0, 0), np.uint8),
        success=0.5,
    )


def test_a_trajectory_is_the_same_from_its_file(tmp_path):
    trajectory(4).write(tmp_path / "one.npz")
    read = read_trajectory(tmp_path / "one.npz")
    assert read.success == 0.5
    for name in ("body", "labels", "frame_of", "rgb", "depth"):
        np.testing.assert_array_equal(getattr(read, name), getattr(trajectory(4), name))


def test_files_that_are_no_trajectories_are_told_from_those_that_are(tmp_path):
    path = tmp_path / "one.npz"
    path.write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(StoreError, match="not a trajectory"):
        read_trajectory(path)
    trajectory(1).write(path)
    arrays = dict(np.load(path))
    np.savez(path, **(arrays | {"frame_of": arrays["frame_of"] + 3}))
    with pytest.raises(StoreError, match="an image that is not there"):
        read_trajectory(path)
    np.savez(path, **(arrays | {"labels": np.array([{"a": 1}], dtype=object)}))
    with pytest.raises(StoreError, match="allow_pickle"):
        read_trajectory(path)
    np.savez_compressed(path, **arrays)
    with pytest.raises(StoreError, match="compressed"):
        read_trajectory(path)


@pytest.fixture
def dataset():
    made = Dataset(cameras=("rgb",), frames=2, chunk=3)
    made.add(trajectory(1))
    made.add(trajectory(2, frames=2))
    return made


def test_every_step_comes_with_its_image_and_the_one_before(dataset):
    batch = dataset.draw(np.random.default_rng(0), 200)
    assert dataset.images == 5
    stacks = {tuple(int(x) for x in stack[::3, 0, 0]) for stack in batch.images["rgb"]}
    # Of each trajectory the first image stands for the one before it.
    assert stacks == {(10, 10), (10, 11), (11, 12), (20, 20), (20, 21)}
    newest = batch.images["rgb"][batch.image_of, -1, 0, 0]
    number, step = batch.body.T
    np.testing.assert_array_equal(newest, 10 * number + step // 2)


def test_labels_go_ahead_to_the_end_of_the_trajectory_and_no_further(dataset):
    batch = dataset.draw(np.random.default_rng(1), 200)
    number, step = batch.body.T
    ahead = step[:, None] + np.arange(3)
    last = np.where(number == 1, 5, 3)[:, None]
    np.testing.assert_array_equal(batch.is_there, ahead <= last)
    wanted = (100.0 * number[:, None] + ahead)[batch.is_there]
    np.testing.assert_array_equal(batch.labels[batch.is_there][:, 0], wanted)


def test_moments_are_those_of_all_trajectories(dataset):
    moments = dataset.moments()
    body = np.concatenate([one.body for one in dataset.trajectories])
    np.testing.assert_allclose(moments["body_mean"], body.mean(0), rtol=1e-6)
    np.testing.assert_allclose(moments["body_std"], body.std(0), rtol=1e-6)
    images = np.concatenate([one.rgb for one in dataset.trajectories]) / 255.0
    np.testing.assert_allclose(moments["image"][:3], images.mean(0), rtol=1e-6)
    np.testing.assert_array_equal(moments["image"][:3], moments["image"][3:])


def test_the_same_generator_draws_the_same_batch(dataset):
    one, two = (dataset.draw(np.random.default_rng(9), 4) for _ in range(2))
    np.testing.assert_array_equal(one.body, two.body)
