"""Places from above and clips, from pictures and meshes that are known."""

from io import BytesIO

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from PIL import Image

from nw_eval.api.evidence_log import LatestPictures, box_round, clip_of, picture_from_above, sized
from nw_sim.rollout.mcap.images import image_message
from nw_sim.rollout.mcap.reader import LoggedMessage


def square(x, y, side, z):
    """Return the two triangles of a level square around a point, (2, 3, 3) m."""
    h = side / 2
    a, b, c, d = ([x + i * h, y + j * h, z] for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return np.array([[a, b, c], [a, c, d]])


def shade(data, box, x, y):
    """Return how bright a point of the world is in a picture."""
    west, south, east, north = box
    with Image.open(BytesIO(data)) as image:
        at = (
            int((x - west) / (east - west) * image.width),
            int((north - y) / (north - south) * image.height),
        )
        return image.convert("L").getpixel(at)


def test_north_is_up_and_what_stands_up_or_is_missing_is_darker_than_the_ground():
    box = box_round(np.array([[0.0, 0.0], [4.0, 0.0]]))
    assert box == (-2.0, -2.0, 6.0, 2.0)
    ground, block = square(2.0, 0.0, 8.0, 0.0), square(3.0, 1.0, 0.6, 0.3)
    mesh = np.concatenate([block, ground])
    data = picture_from_above(mesh, box, ground=0.0, most_bytes=20_000)
    level = shade(data, box, 3.0, -1.0)
    assert shade(data, box, 3.0, 1.0) < level - 30
    assert shade(data, box, 1.0, 1.0) == pytest.approx(level, abs=6)
    pit = picture_from_above(square(2.0, 0.0, 8.0, -0.5), box, ground=0.0, most_bytes=20_000)
    assert shade(pit, box, 1.0, -1.0) < level - 30


def test_a_place_without_a_mesh_or_without_room_has_no_picture():
    box = (-2.0, -2.0, 6.0, 2.0)
    nothing = np.empty((0, 3, 3))
    assert picture_from_above(nothing, box, ground=0.0, most_bytes=20_000) == b""
    ground = square(2.0, 0.0, 8.0, 0.0)
    assert picture_from_above(ground, box, ground=0.0, most_bytes=10) == b""
    assert picture_from_above(ground * np.nan, box, ground=0.0, most_bytes=20_000) == b""


def noise(count):
    rng = np.random.default_rng(0)
    return [
        (index / 10, sized(Image.fromarray(rng.integers(0, 255, (90, 160, 3), dtype=np.uint8))))
        for index in range(count)
    ]


def test_a_clip_keeps_to_its_room_and_still_ends_with_the_last_picture():
    pictures = noise(20)
    large = clip_of(pictures, topic="/camera/ego", end=2.0, most_bytes=10**7)
    small = clip_of(pictures, topic="/camera/ego", end=2.0, most_bytes=60_000)
    assert len(small.data) + len(small.still) <= 60_000 < len(large.data)
    with Image.open(BytesIO(large.data)) as moving:
        assert moving.n_frames == 20
    with Image.open(BytesIO(small.data)) as moving:
        assert moving.n_frames < 20
        moving.seek(moving.n_frames - 1)
        last = np.asarray(moving.convert("L").resize((16, 9)), np.float64).ravel()
    likeness = [
        np.corrcoef(last, np.asarray(image.convert("L").resize((16, 9)), np.float64).ravel())[0, 1]
        for _, image in pictures
    ]
    assert int(np.argmax(likeness)) == 19
    assert clip_of(pictures, topic="/camera/ego", end=2.0, most_bytes=500) is None


def logged(topic, time, image, form="photo"):
    when = round(time * 1e9)
    message = image_message(when, "camera", image, form)
    return LoggedMessage(
        topic=topic,
        kind=message.DESCRIPTOR.full_name,
        time_ns=when,
        data=message.SerializeToString(),
    )


def test_only_the_last_seconds_are_kept_and_ten_pictures_of_each():
    latest = LatestPictures()
    for step in range(500):
        latest.take(logged("/camera/ego", step / 50, np.full((9, 16, 3), step % 250, np.uint8)))
    topic, shown = latest.shown(round(10.0e9))
    assert topic == "/camera/ego"
    times = [time for time, _ in shown]
    assert times[-1] == pytest.approx(9.98)
    assert 7.0 <= times[0] <= 7.1
    assert np.diff(times).min() > 0.099


def test_near_is_bright_and_nothing_is_black_in_a_picture_of_depth():
    depth = np.array([[0.5, 4.0], [0.0, 2.0]])
    latest = LatestPictures()
    latest.take(logged("/camera/ego/depth", 0.1, depth, "metres"))
    topic, [(_, picture)] = latest.shown(round(0.1e9))
    assert topic == "/camera/ego/depth"
    grey = np.asarray(picture.convert("L").resize((2, 2), Image.Resampling.NEAREST))
    assert grey[0, 0] == 255
    assert grey[0, 0] > grey[1, 1] > grey[0, 1] > grey[1, 0] == 0


def test_a_photograph_goes_before_depth_and_a_camera_before_its_others():
    latest = LatestPictures()
    grey = np.zeros((9, 16), np.uint8)
    for topic in ("/camera/ego/wide", "/camera/ego", "/camera/back"):
        latest.take(logged(topic, 0.0, grey, "grey"))
    latest.take(logged("/camera/a", 0.0, grey.astype(np.float32), "metres"))
    assert latest.shown(0)[0] == "/camera/back"


def test_a_picture_that_claims_to_be_vast_is_not_unpacked():
    latest = LatestPictures()
    header = BytesIO()
    Image.new("1", (6000, 6000)).save(header, "PNG")
    message = CompressedImage(format="png", data=header.getvalue())
    latest.take(
        LoggedMessage(
            topic="/camera/ego",
            kind="foxglove.CompressedImage",
            time_ns=0,
            data=message.SerializeToString(),
        )
    )
    with pytest.raises(ValueError, match=r"6000 x 6000"):
        latest.shown(0)
