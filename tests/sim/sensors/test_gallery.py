"""The sheet of all sensors, and that of a card."""

import numpy as np
import pytest
from PIL import Image as PillowImage

from nw_base.errors import SceneError, StoreError
from nw_eval.cli.verbs.sensors import seen_text
from nw_policies import load_bundle
from nw_sim.sensors import gallery
from nw_sim.sensors.drawing.pictures import (
    arrow,
    coloured,
    enlarged,
    picture_of,
    points_from_behind,
)
from nw_splat.camera import Pixels
from nw_splat.image import Image

BARS = (((2.0, 0.0, 0.11), (0.1, 1.0, 0.11)),)


class GreyWall:
    def render(self, camera, pixels=Pixels()):  # noqa: B008 - the renderer's own signature.
        shape = (pixels.count(camera.height), pixels.count(camera.width))
        grey = np.full((*shape, 3), 0.5, dtype=np.float32)
        one = np.ones(shape, dtype=np.float32)
        return Image(rgb=grey, depth=9.0 * one, alpha=one)


def test_every_sensor_is_on_the_sheet(place, tmp_path):
    scene = place(*BARS, trail=((2.0, 0.0, 0.22), (4.0, 0.0, 0.0)))
    path = tmp_path / "sensors.png"
    gallery.draw_gallery(scene, path, renderer=GreyWall())
    sheet = np.asarray(PillowImage.open(path))
    width, height = gallery.PANEL
    assert sheet.shape[1] > 4 * width
    assert sheet.shape[0] > 3 * height
    # The same moment gives the same bytes.
    again = tmp_path / "again.png"
    gallery.draw_gallery(scene, again, renderer=GreyWall())
    assert again.read_bytes() == path.read_bytes()


def test_a_scene_without_a_splat_shows_what_needs_none(place, tmp_path):
    scene = place(*BARS)
    gallery.draw_gallery(scene, tmp_path / "bare.png")
    gallery.draw_gallery(scene, tmp_path / "full.png", renderer=GreyWall())
    bare, full = (np.asarray(PillowImage.open(tmp_path / f"{n}.png")) for n in ("bare", "full"))
    assert bare.shape == full.shape
    rows, columns = np.nonzero((bare != full).any(axis=-1))
    # The three panels of splat_rgb differ, in the first row, and no other.
    width, height = gallery.PANEL
    assert columns.max() < 3 * (width + 8) + 8
    assert rows.max() < 2 * height
    assert (bare[rows, columns] > 200).mean() > 0.8


def test_a_card_that_needs_images_of_a_splat_is_refused_a_scene_without_one(place, tmp_path):
    (tmp_path / "policy.yaml").write_text(
        "nw-policy: 1\nname: m\nrobot: go1\nadapter: zero\n"
        "control: {action: joint_position_offset}\nobservations: {eye: {sensor: splat_rgb}}\n"
    )
    with pytest.raises(SceneError, match="has no splat"):
        gallery.draw_card(load_bundle(tmp_path).card, place(), tmp_path / "seen.png")


def test_a_folder_that_is_not_there_is_made_or_told(place, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="cannot write"):
        gallery.draw_gallery(place(), tmp_path / "file" / "x.png", renderer=GreyWall())


def test_a_card_is_told_and_its_images_are_drawn(place, tmp_path):
    (tmp_path / "policy.yaml").write_text(
        "nw-policy: 1\nname: m\nrobot: go1\nadapter: zero\n"
        "control: {action: joint_position_offset}\n"
        "observations:\n  way: {sensor: direction}\n"
        "  eye: {sensor: depth, wrap: [{wrapper: stack, steps: 2}]}\n"
    )
    told = gallery.draw_card(load_bundle(tmp_path).card, place(*BARS), tmp_path / "seen.png")
    way, eye, picture = seen_text(told).splitlines()
    assert way.startswith("way: direction, 1 float32, ")
    assert eye.startswith("eye: depth, 2 x 45 x 80 float32, ")
    assert picture == str(tmp_path / "seen.png")
    sheet = np.asarray(PillowImage.open(tmp_path / "seen.png"))
    assert sheet.shape[1] < 2 * gallery.PANEL[0]  # One image.


@pytest.mark.parametrize(
    ("shape", "dtype", "unit", "expected"),
    [
        ((9, 16), np.float32, "m", (9, 16, 3)),
        ((9, 16, 3), np.uint8, "rgb", (9, 16, 3)),
        ((3, 9, 16), np.float32, "rgb", (9, 16, 3)),
        ((7, 3, 45, 80), np.float32, "rgb", (45, 80, 3)),
        ((2, 9, 16), np.float32, "m", (9, 16, 3)),
        ((9, 16), np.uint8, "class", (9, 16, 3)),
        ((16, 180, 3), np.float32, "m", None),
        ((53,), np.float32, "mixed", None),
    ],
)
def test_what_can_be_looked_at_becomes_a_picture(shape, dtype, unit, expected):
    image = picture_of(np.ones(shape, dtype), unit)
    assert (None if image is None else image.shape) == expected
    assert image is None or image.dtype == np.uint8


def test_colours_run_from_low_to_high_and_nan_is_grey():
    image = coloured(np.array([[0.0, 1.0, 5.0, np.nan]]), 0.0, 1.0, "gray")
    assert image[0].tolist() == [[0] * 3, [255] * 3, [255] * 3, [128] * 3]


def test_an_enlarged_image_keeps_its_shape():
    big = enlarged(np.full((2, 2, 3), 7, dtype=np.uint8), (40, 20))
    assert big.shape == (20, 40, 3)
    assert (big[:, 10:30] == 7).all()
    assert (big[:, :10] == 250).all()


def test_an_arrow_to_the_left_points_to_the_left():
    picture = arrow(np.pi / 2, (100, 100))
    red = (picture == (230, 62, 40)).all(axis=-1)
    columns = np.argwhere(red)[:, 1]
    assert columns.min() < 15
    assert columns.max() < 75


def test_near_points_cover_far_ones():
    points = np.array([[1.0, 0.0, 0.0], [np.nan, 0.0, 0.0], [-90.0, 0.0, 0.0]])
    picture = points_from_behind(points, (100, 60))
    assert (picture != 18).any(axis=-1).sum() == 4


@pytest.mark.parametrize("axes", ["chw", "hwc"])
def test_colours_of_several_images_along_the_channels_are_shown_as_the_newest_image(axes):
    rng = np.random.default_rng(0)
    older, newest = rng.integers(0, 256, (2, 12, 20, 3), dtype=np.uint8)
    stack = np.concatenate([older, newest], axis=-1)
    sample = np.moveaxis(stack, -1, 0) if axes == "chw" else stack
    np.testing.assert_array_equal(picture_of(sample, "rgb"), newest)
