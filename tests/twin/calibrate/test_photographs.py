"""Photographs are taken in upright, with their focal length, and none that is damaged."""

import shutil

import numpy as np
import pytest
from PIL import Image

from nw_eval.errors import SceneError
from nw_eval.twin.calibrate.photographs import Found, are_numbered, natural, take_in
from nw_eval.twin.calibrate.sources import find_source


def noise(size=(80, 60), seed=0):
    rng = np.random.default_rng(seed)
    return Image.fromarray(rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8))


def taken(folder, tmp_path, *, upright=True):
    source = find_source(folder, tmp_path, frames=50, say=lambda _: None)
    working = tmp_path / "working"
    working.mkdir()
    return take_in(source.files, working, lambda _: None, upright=upright)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "in").mkdir()
    return tmp_path / "in"


def test_a_sideways_phone_picture_is_turned_and_its_focal_length_kept(folder, tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # To be turned a quarter clockwise.
    exif.get_ifd(0x8769)[0xA405] = 28  # Focal length as of 35 mm film.
    picture = noise((10, 8)).resize((80, 60))
    picture.save(folder / "a.jpg", exif=exif, quality=95)
    picture.save(folder / "b.jpg", quality=95)
    (turned, plain), _ = taken(folder, tmp_path)
    assert (turned.width, turned.height) == (60, 80)
    assert turned.focal == pytest.approx(28 / 36 * 80, rel=0.05)
    assert (plain.width, plain.height, plain.focal) == (80, 60, None)
    with Image.open(turned.path) as image:
        found = np.asarray(image, dtype=float)
    wanted = np.rot90(np.asarray(picture, dtype=float), -1)
    assert np.corrcoef(found.ravel(), wanted.ravel())[0, 1] > 0.98


def test_pictures_that_others_calibrated_are_not_turned(folder, tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    noise().save(folder / "a.jpg", exif=exif)
    (one,), _ = taken(folder, tmp_path, upright=False)
    assert (one.width, one.height) == (80, 60)


def test_damaged_and_strange_files_are_named_and_the_rest_taken(folder, tmp_path):
    noise().save(folder / "good é\n #1.png")
    noise().convert("CMYK").save(folder / "print.jpg")
    noise().convert("P").save(folder / "few colours.png")
    whole = (folder / "good é\n #1.png").read_bytes()
    (folder / "cut.png").write_bytes(whole[:3000])
    (folder / "empty.jpg").write_bytes(b"")
    (folder / "phone.heic").write_bytes(b"\0\0\0\x18ftypheic")
    (folder / "huge.png").write_bytes(b"P6 60000 60000 255\n")
    Image.fromarray(np.full((60, 80), 40000, np.uint16)).save(folder / "16 bits.png")
    (folder / "notes.txt").write_text("none of these", encoding="utf-8")
    secret = tmp_path / "secret.png"
    noise().save(secret)
    (folder / "link.png").symlink_to(secret)
    good, bad = taken(folder, tmp_path)
    names = {one.name for one in good}
    assert names == {"good é\n #1.png", "print.jpg", "few colours.png"}
    names = {one.name for one in bad}
    assert names == {"cut.png", "empty.jpg", "phone.heic", "huge.png", "link.png", "16 bits.png"}
    assert {one.reason for one in bad} == {"cannot be read"}
    for one in good:
        with Image.open(one.path) as image:
            assert (image.size, image.mode) == ((80, 60), "RGB")
            assert one.file.isascii()


def test_masks_beside_are_found_by_either_name(folder, tmp_path):
    (folder / "masks").mkdir()
    white = Image.new("L", (80, 60), 255)
    for name, mask in (("a.jpg", "a.jpg.png"), ("b.jpg", "B.png"), ("c.jpg", None)):
        noise().save(folder / name)
        if mask:
            white.save(folder / "masks" / mask)
    good, _ = taken(folder, tmp_path)
    assert [one.mask is not None for one in good] == [True, True, False]


@pytest.mark.parametrize("damage", ["size", "cut", "link"])
def test_a_mask_that_does_not_fit_is_an_error(folder, tmp_path, damage):
    (folder / "masks").mkdir()
    noise().save(folder / "a.jpg")
    path = folder / "masks" / "a.png"
    if damage == "size":
        Image.new("L", (40, 30)).save(path)
    elif damage == "cut":
        path.write_bytes(b"\x89PNG")
    else:
        Image.new("L", (80, 60)).save(tmp_path / "outside.png")
        path.symlink_to(tmp_path / "outside.png")
    with pytest.raises(SceneError, match="the mask"):
        taken(folder, tmp_path)


def test_photographs_in_images_are_found_with_masks_beside_it(folder, tmp_path):
    for kind in ("images", "masks"):
        (folder / kind).mkdir()
    noise().save(folder / "images" / "a.png")
    Image.new("L", (80, 60), 255).save(folder / "masks" / "a.png")
    (one,), _ = taken(folder, tmp_path)
    assert one.mask is not None
    shutil.rmtree(folder / "images")
    with pytest.raises(SceneError, match="nothing in"):
        find_source(folder, tmp_path, frames=9, say=lambda _: None)


def test_blur_lowers_sharpness_and_not_the_order_of_names(folder, tmp_path):
    picture = noise((640, 480))
    picture.save(folder / "IMG_10.png")
    picture.reduce(8).resize((640, 480), Image.Resampling.BICUBIC).save(folder / "IMG_9.png")
    (blurred, sharp), _ = taken(folder, tmp_path)
    assert blurred.name == "IMG_9.png"
    assert blurred.sharpness < 0.1 * sharp.sharpness


@pytest.mark.parametrize(
    ("names", "numbered"),
    [
        (["IMG_0001.jpg", "IMG_0002.jpg", "IMG_10.jpg"], True),
        (["20240101_120000.jpg", "20240101_120007.jpg"], True),
        (["door.jpg", "stairs.jpg"], False),
        (["IMG_1.jpg", "DSC_2.jpg"], False),
        (["IMG_1.jpg"], False),
    ],
)
def test_names_that_count_are_told_from_others(names, numbered):
    assert are_numbered(names) is numbered


def test_any_names_can_be_sorted():
    names = ["10", "9", "a", "a2b", "a10b", "", "é", "²3", "a02b"]
    assert sorted(names, key=natural)[:3] == ["", "9", "10"]
    assert sorted({*names}, key=natural) == sorted(names, key=natural)
    assert [n for n in sorted(names, key=natural) if n[:1] == "a"] == ["a", "a02b", "a2b", "a10b"]


def test_a_source_that_says_why_it_cannot_be_read_is_believed(tmp_path):
    found = Found(name="x", path=None, fault="it has no camera")
    _, bad = take_in([found], tmp_path, lambda _: None, upright=True)
    assert bad[0].detail == "it has no camera"


def test_a_photograph_larger_than_asked_for_is_left_out_and_the_option_is_named(tmp_path):
    Image.fromarray(np.zeros((1000, 1300), np.uint8)).save(tmp_path / "large.png")
    found = [Found(name="large.png", path=tmp_path / "large.png")]
    taken_in = {}
    for most in (1, 2):
        (working := tmp_path / str(most)).mkdir()
        taken_in[most] = take_in(found, working, lambda _: None, upright=True, megapixels=most)
    assert len(taken_in[2][0]) == 1
    assert taken_in[1][1][0].detail == (
        "1.3 million pixels, of 1 million at most: make it smaller, or give --megapixels"
    )
