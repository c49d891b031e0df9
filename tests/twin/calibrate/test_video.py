"""Of a film, the frames that are sharp and that lie as far apart as the picture moved."""

import struct

import av
import cv2
import numpy as np
import pytest
import synthetic_room
from films import film
from PIL import Image

from nw_base.errors import SceneError, UsageError
from nw_twin.calibrate.calibrate import find_source
from nw_twin.calibrate.video import choose, frames_of
from nw_twin.options import CalibrateOptions


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


@pytest.fixture
def wall():
    return synthetic_room.noise(np.random.default_rng(0), 120, 700).astype(np.uint8)


def test_frames_of_a_film_are_spaced_by_motion_and_blurred_ones_passed_over(wall, tmp_path):
    starts = [*[0] * 20, *range(0, 320, 4), *[320] * 20]
    frames = [wall[:, s : s + 192] for s in starts]
    for i in range(0, len(frames), 2):
        frames[i] = cv2.GaussianBlur(frames[i], (0, 0), 3)
    film(tmp_path / "walk.mp4", frames, qscale="2")
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
    film(path, [wall[:, :192]] * 8, qscale="2")
    data = {"empty": b"", "cut": path.read_bytes()[:300], "text": b"no film" * 99}
    path.write_bytes(data[damage])
    with pytest.raises(SceneError, match=r"walk\.mp4"):
        find_source(path, tmp_path, frames=60, say=lambda _: None)


def test_two_frames_are_too_few(wall, tmp_path):
    film(tmp_path / "walk.mp4", [wall[:, :192]] * 2)
    with pytest.raises(SceneError, match="2 frames"):
        find_source(tmp_path / "walk.mp4", tmp_path, frames=60, say=lambda _: None)


def opened(source):
    with Image.open(source.files[0].path) as image:
        return np.asarray(image)


# 16.16 fixed point as in an MP4's track header, and what is then to be seen.
MATRICES = {
    "portrait": ((0, 1, -1, 0), lambda a: np.rot90(a, -1)),
    "upside down": ((-1, 0, 0, -1), lambda a: np.rot90(a, 2)),
    "portrait, turned the other way": ((0, -1, 1, 0), np.rot90),
    "mirrored": ((-1, 0, 0, 1), np.fliplr),
    "portrait of a selfie camera": ((0, 1, 1, 0), lambda a: a.swapaxes(0, 1)),
}


@pytest.mark.parametrize("kind", MATRICES)
def test_a_film_is_turned_and_mirrored_as_its_track_says(tmp_path, kind):
    (a, b, c, d), turn = MATRICES[kind]
    shown = np.zeros((128, 192, 3), np.uint8)
    shown[:40, :60], shown[:40, -60:], shown[-40:, :60] = (250, 0, 0), (0, 250, 0), (0, 0, 250)
    path = tmp_path / "walk.mp4"
    film(path, [shown] * 8, qscale="2")
    data = bytearray(path.read_bytes())
    place = data.index(b"tkhd") + 4 + 4 + 20 + 8 + 8  # Version 0: times, layer, volume.
    one = 1 << 16
    rows = (a * one, b * one, 0, c * one, d * one, 0, 0, 0, 1 << 30)
    data[place : place + 36] = struct.pack(">9i", *rows)
    path.write_bytes(data)
    found = opened(find_source(path, tmp_path, frames=3, say=lambda _: None))
    wanted = turn(shown.astype(float))
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).mean() < 12


@pytest.mark.parametrize(("transfer", "name"), [(16, "PQ"), (18, "HLG")])
def test_an_hdr_film_is_tone_mapped_and_said(tmp_path, transfer, name):
    grey = 64 + round(876 * 0.38)  # Of a grey card, by ITU-R BT.2408.
    frames = [av.VideoFrame(96, 64, "yuv420p10le") for _ in range(4)]
    for frame in frames:
        for plane, level in zip(frame.planes, (grey, 512, 512), strict=True):
            row = np.full((plane.height, plane.line_size // 2), level, np.uint16)
            plane.update(row.tobytes())
    tags = f"log-level=none:pools=1:transfer={transfer}:colorprim=9:colormatrix=9"
    codec = {"codec": "libx265", "form": "yuv420p10le", "x265-params": tags}
    film(tmp_path / "walk.mov", frames, **codec, crf="5", preset="ultrafast")
    said = []
    source = find_source(tmp_path / "walk.mov", tmp_path, frames=3, say=said.append)
    assert opened(source).mean() == pytest.approx(118, abs=5)
    assert f"walk.mov is HDR ({name}): its frames are tone-mapped to sRGB" in said


@pytest.mark.parametrize("most", [60, 3])
def test_one_picture_a_second_is_taken_though_the_rate_varies(wall, tmp_path, most):
    # Two seconds of 5 frames, then four of 15, where dark scenes have longer frames.
    times = np.r_[np.arange(10) * 200, 2000 + np.arange(60) * 66]
    frames = [wall[:, number : number + 192] for number in range(len(times))]
    for number in range(len(times)):
        if number % 3:  # Every third is sharp.
            frames[number] = cv2.GaussianBlur(frames[number], (0, 0), 3)
    film(tmp_path / "walk.mp4", frames, rate=30, times=times.tolist())
    said = []
    source = find_source(
        tmp_path / "walk.mp4", tmp_path, frames=most, say=said.append, per_second=1.0
    )
    numbers = [int(one.name[6:12]) for one in source.files]
    assert [n % 3 for n in numbers] == [0] * len(numbers)
    seconds = (times[numbers] / 1000).astype(int).tolist()
    if most == 60:
        assert seconds == [0, 1, 2, 3, 4, 5]
    else:
        assert [s // 2 for s in seconds] == [0, 1, 2]
        assert any("are 6: 3 are taken" in line and "--frames 6 takes all" in line for line in said)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_no_frames_a_second_are_refused(rate):
    with pytest.raises(UsageError, match="frames a second"):
        CalibrateOptions(per_second=rate)


@pytest.mark.parametrize(("rate", "said"), [(10000, True), (30, False)])
def test_a_film_whose_header_lies_about_its_rate_is_read_all_the_same(tmp_path, rate, said):
    lines = []
    path = tmp_path / "film.mkv"
    picture = np.random.default_rng(1).integers(0, 255, (96, 320, 3), dtype=np.uint8)
    film(path, [picture[:, 4 * n : 4 * n + 160] for n in range(30)], rate=rate)
    (tmp_path / "work").mkdir()
    found = frames_of(path, tmp_path / "work", 20, lines.append)
    assert len(found.files) >= 3
    assert any("30 frames claim to last" in line for line in lines) == said


def test_a_film_of_a_line_of_pixels_is_refused_in_words(tmp_path):
    path = tmp_path / "line.mkv"
    film(path, [np.zeros((2, 4000, 3), np.uint8)] * 4, codec="ffv1", form="yuv444p")
    with pytest.raises(SceneError, match="pictures of 4000 x 2 pixels, which show nothing"):
        frames_of(path, tmp_path, 20, lambda _: None)


@pytest.mark.parametrize(
    "text",
    [
        "ffconcat version 1.0\nfile other.avi\n",
        "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:2,\nother.avi\n#EXT-X-ENDLIST\n",
        "v=0\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n",
    ],
    ids=["list", "playlist", "session"],
)
def test_a_film_that_names_other_files_or_servers_is_refused(tmp_path, wall, text):
    film(tmp_path / "other.avi", [wall[:, n : n + 160] for n in range(0, 300, 3)])
    (tmp_path / "film.mp4").write_text(text)
    (tmp_path / "work").mkdir()
    with pytest.raises(SceneError, match=r"film\.mp4 cannot be read: .*; save it again"):
        frames_of(tmp_path / "film.mp4", tmp_path / "work", 10, lambda _: None)
