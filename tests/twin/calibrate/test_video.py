"""Of a film, the frames that are sharp and that lie as far apart as the picture moved."""

import av
import cv2
import numpy as np
import pytest
import synthetic_room

from nw_eval.errors import SceneError
from nw_eval.twin.calibrate.sources import find_source
from nw_eval.twin.calibrate.video import choose


def test_a_resting_camera_gives_few_frames_and_a_moving_one_many():
    moved = np.r_[np.zeros(100), np.full(100, 0.03), np.zeros(100)]
    chosen = choose(moved, np.ones(300), 150)
    assert len(chosen) == 50
    assert len([i for i in chosen if 100 <= i < 200]) >= 48


def test_of_each_stretch_the_sharpest_is_taken():
    moved = np.full(300, 0.01)
    sharpness = np.where(np.arange(300) % 6 == 4, 9.0, 1.0)
    chosen = choose(moved, sharpness, 150)
    assert (sharpness[chosen] == 9).all()
    assert len(chosen) == 50


def test_no_more_are_taken_than_were_wanted_and_they_span_the_film():
    chosen = choose(np.full(3000, 0.05), np.ones(3000), 40)
    assert len(chosen) == 40
    assert chosen == sorted(set(chosen))
    assert chosen[-1] - chosen[0] > 2800


def test_a_film_of_nothing_still_gives_a_frame():
    assert len(choose(np.zeros(10), np.ones(10), 150)) >= 1


def film(path, frames):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=15)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.options = {"qscale": "2"}
        for frame in frames:
            for packet in stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)


@pytest.fixture
def wall():
    return synthetic_room.noise(np.random.default_rng(0), 120, 700).astype(np.uint8)


def test_frames_of_a_film_are_spaced_by_motion_and_blurred_ones_passed_over(wall, tmp_path):
    starts = [*[0] * 20, *range(0, 320, 4), *[320] * 20]
    frames = [wall[:, s : s + 192] for s in starts]
    for i in range(0, len(frames), 2):
        frames[i] = cv2.GaussianBlur(frames[i], (0, 0), 3)
    film(tmp_path / "walk.mp4", frames)
    source = find_source(tmp_path / "walk.mp4", tmp_path, frames=60, say=lambda _: None)
    numbers = [int(one.name[6:12]) for one in source.files]
    assert source.is_film
    assert numbers == sorted(set(numbers))
    assert 15 <= len(numbers) <= 60
    assert np.mean([n % 2 for n in numbers]) > 0.9  # The sharp ones.
    assert len([n for n in numbers if 20 <= n < 100]) > 0.8 * len(numbers)
    assert all(one.path.is_file() for one in source.files)


@pytest.mark.parametrize("damage", ["empty", "cut", "text"])
def test_a_film_that_cannot_be_read_is_named(wall, tmp_path, damage):
    path = tmp_path / "walk.mp4"
    film(path, [wall[:, :192]] * 8)
    data = {"empty": b"", "cut": path.read_bytes()[:300], "text": b"no film" * 99}
    path.write_bytes(data[damage])
    with pytest.raises(SceneError, match=r"walk\.mp4"):
        find_source(path, tmp_path, frames=60, say=lambda _: None)


def test_two_frames_are_too_few(wall, tmp_path):
    film(tmp_path / "walk.mp4", [wall[:, :192]] * 2)
    with pytest.raises(SceneError, match="2 frames"):
        find_source(tmp_path / "walk.mp4", tmp_path, frames=60, say=lambda _: None)
