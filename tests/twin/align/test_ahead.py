"""What gives the scale is said in the first seconds, before anything is computed."""

import re
import struct
import zlib
from contextlib import nullcontext

import numpy as np
import pytest
from PIL import ExifTags, Image
from rooms import capture
from tags import picture, texture
from test_scale import around, lying

from nw_base.errors import UsageError
from nw_twin.align.ahead import (
    SourceFacts,
    facts_of_source,
    read_facts,
    scale_lines,
    write_facts,
)
from nw_twin.align.alignment import AlignOptions, KnownLength
from nw_twin.calibrate.photographs import Footage, photographs_in

NOTHING = AlignOptions()


def taken(folder, *, tag=None, east=None):
    """Write four photographs: of a tag, or with places so many metres apart, or of nothing."""
    rng = np.random.default_rng(0)
    folder.mkdir()
    for i, shot in enumerate(capture(np.zeros((1, 3)), around(rng, 4), size=(480, 360)).shots):
        exif = Image.Exif()
        if east is not None:
            seconds = 10.0 + i * east / 30.9  # A second of arc of the equator has 30.9 m.
            exif.get_ifd(ExifTags.IFD.GPSInfo).update(
                {1: "N", 2: (0.0, 0.0, 0.0), 3: "E", 4: (10.0, 0.0, seconds)}
            )
        tags = [] if tag is None else [(texture(tag), lying(3.0, 2.5), 0.4)]
        Image.fromarray(picture(shot.camera, tags, rng)).save(folder / f"IMG_{i}.jpg", exif=exif)
    return photographs_in(folder)


def said(footage, options=NOTHING):
    return " | ".join(scale_lines(facts_of_source(footage, options), options, "street"))


def test_without_any_scale_it_says_so_and_how_to_give_one_now_and_later(tmp_path):
    words = said(taken(tmp_path / "nothing"))
    assert words.startswith("scale: nothing gives one: no tag, GPS or metric poses were found")
    for way in ("--tag-edge METRES", "--camera-height METRES", "--length A B METRES"):
        assert way in words
    assert "`nw-eval twin place street --length A B METRES`" in words
    assert "`nw-eval twin label street`" in words


def test_pictures_that_claim_too_much_or_have_too_few_pixels_stop_nothing(tmp_path, recwarn):
    folder = tmp_path / "odd"
    folder.mkdir()
    for name, size in (("dot", (1, 1)), ("line", (2000, 2)), ("one", (64, 48))):
        Image.new("L", size).save(folder / f"{name}.png")
    bomb = bytearray((folder / "one.png").read_bytes())
    bomb[16:24] = struct.pack(">II", 60_000, 60_000)
    bomb[29:33] = struct.pack(">I", zlib.crc32(bomb[12:29]))
    (folder / "bomb.png").write_bytes(bomb)
    assert "nothing gives one" in said(photographs_in(folder))
    assert not recwarn.list


def test_a_tag_in_view_needs_its_edge_and_then_gives_the_scale(tmp_path):
    footage = taken(tmp_path / "tag", tag=7)
    words = said(footage)
    assert "nothing gives one yet" in words
    assert "tag 7 is in 4 of the 4 photographs looked at: measure" in words
    words = said(footage, AlignOptions(tag_edge=0.4))
    assert words == "scale: by --tag-edge 0.4: tag 7 is in 4 of the 4 photographs looked at"
    words = said(taken(tmp_path / "none"), AlignOptions(tag_edge=0.4))
    assert (
        words == "scale: by --tag-edge 0.4: no AprilTag is in the photographs that were looked at"
    )


def test_gps_gives_the_scale_where_photographs_lie_far_apart(tmp_path):
    far = taken(tmp_path / "far", east=20.0)
    assert said(far) == ("scale: by GPS in 4 of 4 photographs, over 60 m: good to about 8%")
    near = said(taken(tmp_path / "near", east=3.0))
    assert "nothing gives one yet" in near
    assert "over 9 m: too near together for a scale" in near
    options = facts_of_source(far, NOTHING).completed(NOTHING, [one.name for one in far.files])
    assert options.positions["IMG_3.jpg"] == pytest.approx((60.0, 0.0, 0.0), abs=0.2)
    assert facts_of_source(far, NOTHING).completed(NOTHING, ["IMG_0.jpg"]) == NOTHING


def test_cameras_that_come_in_metres_give_scale_and_up():
    polycam = Footage(kind="polycam", files=(), metric=True, up=(0.0, 1.0, 0.0))
    facts = facts_of_source(polycam, NOTHING)
    assert scale_lines(facts, NOTHING, "room") == [
        "scale: by the cameras of polycam: poses in metres"
    ]
    options = facts.completed(NOTHING, [])
    assert (options.metric, options.up) == (True, "+y")
    words = said(Footage(kind="nerfstudio", files=()))
    assert "--metric says that the cameras of nerfstudio are in metres, if they are" in words


def test_a_length_in_a_photograph_that_is_not_there_is_an_error_at_once(tmp_path):
    length = KnownLength.of_words("IMG_1.jpg:1,2", "IMG_9.jpg:1,2", 1.0)
    with pytest.raises(UsageError, match=r"there is no photograph 'IMG_9\.jpg'; did you mean"):
        facts_of_source(taken(tmp_path / "four"), AlignOptions(lengths=(length,)))


@pytest.mark.parametrize(
    ("lengths", "words"),
    [
        ([("IMG_1.jpg:1,2", "IMG_1.jpg:1,2", 1.0)], "are one: IMG_1.jpg:1,2 and IMG_1.jpg:1,2"),
        ([("IMG_1.jpg:1,2+IMG_2.jpg:5,6", "IMG_2.jpg:5,6", 1.0)], "are one: "),
        ([("IMG_1.jpg:480,2", "IMG_2.jpg:5,6", 1.0)], "outside the .* has 480 x 360 pixels"),
        ([("IMG_1.jpg:1,2", "IMG_2.jpg:5,400", 1.0)], "IMG_2.jpg:5,400 is outside"),
        (
            [("IMG_1.jpg:1,2", "IMG_2.jpg:5,6", 1.0), ("IMG_2.jpg:5,6", "IMG_1.jpg:1,2", 1.1)],
            "contradict each other: 1.1 m between .*, and 1 m by others",
        ),
        (
            [
                ("IMG_1.jpg:1,2", "IMG_2.jpg:5,6", 1.0),
                ("IMG_2.jpg:5,6", "IMG_3.jpg:5,6", 1.0),
                ("IMG_1.jpg:1,2", "IMG_3.jpg:5,6", 5.0),
            ],
            "contradict each other: 5 m between .*, and 2 m by others",
        ),
    ],
)
def test_a_length_that_cannot_be_is_refused_before_anything_is_computed(
    lengths, words, tmp_path, ended
):
    taken(tmp_path / "four")
    options = [word for a, b, metres in lengths for word in ("--length", a, b, metres)]
    source, out = tmp_path / "four", tmp_path / "room"
    code, printed = ended("twin", "build", source, "--out", out, *options)
    assert code == 2
    assert re.search(words, printed.err)
    assert "photographs read" not in printed.out


def test_lengths_that_a_place_can_have_are_taken(tmp_path):
    ends = ("IMG_1.jpg:1,2", "IMG_2.jpg:5,6", "IMG_3.jpg:5,6")
    sides = ((0, 1, 1.0), (1, 0, 1.02), (1, 2, 1.0), (0, 2, 1.9))
    lengths = tuple(KnownLength.of_words(ends[a], ends[b], metres) for a, b, metres in sides)
    options = AlignOptions(lengths=lengths)
    lines = scale_lines(facts_of_source(taken(tmp_path / "four"), options), options, tmp_path)
    told = " | ".join(lines)
    for metres in ("1 m", "1.02 m", "1.9 m"):
        assert f"--length: {metres} between" in told, told


@pytest.mark.parametrize(("turn", "fits"), [(1, False), (6, True)])
def test_pixels_of_a_photograph_are_counted_as_it_is_seen_upright(tmp_path, turn, fits):
    (tmp_path / "in").mkdir()
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = turn
    Image.new("L", (480, 360)).save(tmp_path / "in" / "IMG_1.jpg", exif=exif)
    length = KnownLength.of_words("IMG_1.jpg:100,470", "IMG_1.jpg:5,6", 1.0)
    with nullcontext() if fits else pytest.raises(UsageError, match="has 480 x 360"):
        facts_of_source(photographs_in(tmp_path / "in"), AlignOptions(lengths=(length,)))


def test_a_build_says_it_before_photographs_are_read_and_continues(tmp_path, ended):
    taken(tmp_path / "photographs")
    source, out = tmp_path / "photographs", tmp_path / "room"
    code, printed = ended("twin", "build", source, "--out", out)
    assert code == 2  # Four pictures of a grey wall cannot be calibrated.
    lines = printed.out.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("scale: nothing gives one"))
    assert first < next(i for i, line in enumerate(lines) if line.startswith("photographs read"))
    assert f"nw-eval twin label {tmp_path / 'room'}" in printed.out


def test_what_is_known_survives_the_disk(tmp_path):
    facts = SourceFacts(
        kind="photographs",
        photographs=3,
        positions={"a.jpg": (1.0, 2.0, 3.0)},
        looked_at=3,
        tags={7: 2},
    )
    assert read_facts(tmp_path) is None
    write_facts(facts, tmp_path)
    assert read_facts(tmp_path) == facts
