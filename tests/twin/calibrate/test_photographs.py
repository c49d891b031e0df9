"""Photographs are taken in upright, with their focal length, and none that is damaged."""

import shutil
import struct

import numpy as np
import pillow_heif
import pytest
from PIL import Image

from nw_base.errors import SceneError
from nw_twin.calibrate.calibrate import find_source
from nw_twin.calibrate.photographs import (
    Found,
    are_numbered,
    natural,
    take_in,
    tone_mapped,
)
from nw_twin.calibrate.solution import Placed, Solution
from nw_twin.lens import Lens


def noise(size=(80, 60), seed=0):
    rng = np.random.default_rng(seed)
    return Image.fromarray(rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8))


def taken(folder, tmp_path, *, cameras=None, say=lambda _: None):
    source = find_source(folder, tmp_path, frames=50, say=lambda _: None)
    working = tmp_path / "working"
    working.mkdir()
    return take_in(source.files, working, say, cameras=cameras)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "in").mkdir()
    return tmp_path / "in"


# EXIF's orientations: where the first row and the first column of the file are to be seen.
TURNS = {
    1: lambda a: a,
    2: np.fliplr,
    3: lambda a: np.rot90(a, 2),
    4: np.flipud,
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(a, -1)[::-1],
    8: np.rot90,
}


def exif_of(orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    exif.get_ifd(0x8769)[0xA405] = 28  # Focal length as of 35 mm film.
    return exif.tobytes()


@pytest.mark.parametrize("suffix", ["jpg", "heic"])
def test_photographs_of_all_orientations_are_turned_and_keep_their_focal_length(
    folder, tmp_path, suffix
):
    pillow_heif.register_heif_opener()
    picture = noise((10, 8)).resize((80, 60))
    for orientation in TURNS:
        name = folder / f"{orientation}.{suffix}"
        picture.save(name, exif=exif_of(orientation), quality=95)
    picture.save(folder / f"9.{suffix}", quality=95)
    good, bad = taken(folder, tmp_path)
    assert bad == []
    for (orientation, turn), one in zip([*TURNS.items(), (9, TURNS[1])], good, strict=True):
        wanted = turn(np.asarray(picture, dtype=float))
        with Image.open(one.path) as image:
            found = np.asarray(image.convert("RGB"), dtype=float)
        assert one.name == f"{orientation}.{suffix}"
        assert (one.height, one.width) == found.shape[:2] == wanted.shape[:2]
        assert np.corrcoef(found.ravel(), wanted.ravel())[0, 1] > 0.98
        # EXIF's focal length is of a diagonal of 43.27 mm.
        known = None if orientation == 9 else pytest.approx(28 / 43.27 * 100, rel=1e-3)
        assert one.focal == known


def test_a_jpeg_with_a_depth_map_stays_the_file_that_it_is(folder, tmp_path):
    noise().save(folder / "a.jpg", "MPO", save_all=True, append_images=[noise((20, 15))])
    (one,), _ = taken(folder, tmp_path)
    assert (one.file, one.path.is_symlink()) == ("000000.jpg", True)
    assert (one.width, one.height) == (80, 60)


@pytest.mark.parametrize(("size", "turned"), [((80, 60), False), ((60, 80), True)])
def test_pictures_that_others_calibrated_have_their_cameras_shape(folder, tmp_path, size, turned):
    noise().save(folder / "a.jpg", exif=exif_of(6))
    lens = Lens(model="PINHOLE", width=size[0] * 2, height=size[1] * 2, params=(90, 90, 80, 60))
    cameras = Solution(placed=(Placed(name="a.jpg", lens=lens, T_world_camera=np.eye(4)),))
    (one,), _ = taken(folder, tmp_path, cameras=cameras)
    assert (one.width, one.height) == size
    assert one.path.is_symlink() is not turned


@pytest.mark.parametrize(("transfer", "signal"), [(16, [0.38, 0.58]), (18, [0.38, 0.75])])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_grey_and_white_of_hdr_are_those_of_a_photograph(transfer, signal, kind):
    # ITU-R BT.2408: a grey card and paper white are at these signals. sRGB's 18 % grey is 118.
    most = np.iinfo(kind).max
    levels = (np.array([0.0, *signal, 1.0]) * most).astype(kind)
    black, grey, white, light = tone_mapped(np.repeat(levels, 3).reshape(1, 4, 3), transfer)[0]
    assert black.tolist() == [0, 0, 0]
    assert grey == pytest.approx(118, abs=4)
    assert 235 < white.min() <= white.max() < light.min()
    # Pure red of BT.2020 is outside of sRGB, and stays red.
    red = tone_mapped(np.array([[[most, 0, 0]]], dtype=kind), transfer)[0, 0]
    assert red.tolist() == [255, 0, 0]


def test_an_hdr_photograph_is_tone_mapped_and_said(folder, tmp_path):
    pillow_heif.register_heif_opener()
    heif = pillow_heif.from_pillow(Image.new("RGB", (80, 60), (97, 97, 97)))
    nclx = {"color_primaries": 9, "transfer_characteristics": 18, "matrix_coefficients": 9,
            "full_range_flag": 1}  # fmt: skip
    heif.info["nclx_profile"] = nclx
    heif.save(folder / "a.heic", quality=95, **nclx)
    said = []
    (one,), _ = taken(folder, tmp_path, say=said.append)
    with Image.open(one.path) as image:
        assert np.asarray(image).mean() == pytest.approx(118, abs=5)
    assert "1 photograph in HDR, as a.heic: tone-mapped to sRGB" in said


def test_damaged_and_strange_files_are_named_and_the_rest_taken(folder, tmp_path):
    noise().save(folder / "good é\n #1.png")
    noise().convert("CMYK").save(folder / "print.jpg")
    noise().convert("P").save(folder / "few colours.png")
    whole = (folder / "good é\n #1.png").read_bytes()
    (folder / "cut.png").write_bytes(whole[:3000])
    (folder / "empty.jpg").write_bytes(b"")
    (folder / "phone.heic").write_bytes(b"\0\0\0\x18ftypheic")
    pillow_heif.from_pillow(noise()).save(folder / "bomb.heic")
    heic = bytearray((folder / "bomb.heic").read_bytes())
    heic[(place := heic.index(b"ispe") + 8) : place + 8] = struct.pack(">II", 60_000, 60_000)
    (folder / "bomb.heic").write_bytes(heic)
    (folder / "huge.png").write_bytes(b"P6 60000 60000 255\n")
    Image.fromarray(np.full((60, 80), 40000, np.uint16)).save(folder / "16 bits.png")
    Image.new("L", (2000, 20)).save(folder / "line.png")
    (folder / "notes.txt").write_text("none of these", encoding="utf-8")
    secret = tmp_path / "secret.png"
    noise().save(secret)
    (folder / "link.png").symlink_to(secret)
    good, bad = taken(folder, tmp_path)
    names = {one.name for one in good}
    assert names == {"good é\n #1.png", "print.jpg", "few colours.png"}
    names = {one.name for one in bad}
    assert names == {
        *("cut.png", "empty.jpg", "phone.heic", "huge.png", "link.png", "16 bits.png"),
        *("bomb.heic", "line.png"),
    }
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
    _, bad = take_in([found], tmp_path, lambda _: None)
    assert bad[0].detail == "it has no camera"


def test_a_photograph_larger_than_asked_for_is_left_out_and_the_option_is_named(tmp_path):
    Image.fromarray(np.zeros((1000, 1300), np.uint8)).save(tmp_path / "large.png")
    found = [Found(name="large.png", path=tmp_path / "large.png")]
    taken_in = {}
    for most in (1, 2):
        (working := tmp_path / str(most)).mkdir()
        taken_in[most] = take_in(found, working, lambda _: None, megapixels=most)
    assert len(taken_in[2][0]) == 1
    assert taken_in[1][1][0].detail == (
        "1.3 million pixels, of 1 million at most: make it smaller, or give --megapixels"
    )
