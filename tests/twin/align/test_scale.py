"""A unit's length by tags, heights, positions and lengths, and what is said where they differ."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import ExifTags, Image
from rooms import capture, degrees_off, patch, room, scale_off, similarity, straight, walk
from tags import picture, texture
from twin_parts import grid

from nw_base.errors import SceneError, UsageError
from nw_splat.camera import look_at
from nw_twin.align.align import align
from nw_twin.align.alignment import AlignOptions, KnownLength, words_of
from nw_twin.align.positions import east_north_up, fit_positions, gps_positions
from nw_twin.align.tags import triangulate
from nw_twin.lens import Lens

SIZE = (480, 360)


def lying(x, y, turn=0.3):
    """Return the frame of a tag that lies on the floor."""
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def around(rng, count=8):
    """Return poses round the middle of a room, looking at what lies there."""
    turns = 2 * np.pi * (np.arange(count) + 0.3) / count
    eyes = np.column_stack([3 + 1.3 * np.cos(turns), 2.5 + 1.3 * np.sin(turns), 0 * turns + 1.2])
    return np.array([look_at(eye, np.array([3, 2.5, 0]) + rng.normal(0, 0.1, 3)) for eye in eyes])


def photographed(folder, rng, tags, T, poses=None, wrong=()):
    """Return a capture whose pictures show tags; those of `wrong` were taken from elsewhere."""
    poses = around(rng) if poses is None else poses
    names = [f"{i}.png" for i in range(len(poses))]
    taken = poses.copy()
    taken[list(wrong), :3, 3] += [0.15, 0.1, 0.0]
    here = capture(np.zeros((1, 3)), taken, size=SIZE)
    for shot, name in zip(here.shots, names, strict=True):
        Image.fromarray(picture(shot.camera, tags, rng)).save(folder / name, compress_level=1)
    return capture(room(rng, floor=400, walls=200), poses, T, files=names, size=SIZE)


def test_a_tag_gives_the_scale_within_a_percent_and_nothing_else_is_needed(tmp_path):
    rng = np.random.default_rng(1)
    T = similarity(rng)
    tags = [(texture(7), lying(3.1, 2.4), 0.2)]
    alignment = align(
        photographed(tmp_path, rng, tags, T), tmp_path, None, AlignOptions(tag_edge=0.2)
    )
    assert abs(scale_off(alignment, T)) < 0.01
    assert degrees_off(alignment, T) < 0.3
    assert alignment.scales[0].name == "tag"
    assert alignment.warnings == ()


def test_two_tags_and_shots_that_are_wrong_do_not_matter_but_another_edge_does(tmp_path):
    rng = np.random.default_rng(2)
    T = similarity(rng)
    for edge in (0.2, 0.3):
        tags = [(texture(7), lying(3.2, 2.2), 0.2), (texture(11), lying(2.7, 2.8, 1.0), edge)]
        found = photographed(tmp_path, rng, tags, T, wrong=(2, 5))
        alignment = align(found, tmp_path, options=AlignOptions(tag_edge=0.2))
        assert "tag 7, 11 in 6 shots" in alignment.scales[0].reason
        disagree = any("the tags disagree" in warning for warning in alignment.warnings)
        assert disagree == (edge == 0.3)
        assert disagree or abs(scale_off(alignment, T)) < 0.01


def test_without_a_scale_the_cameras_are_as_high_as_people_carry_them_and_it_says_so(tmp_path):
    rng = np.random.default_rng(4)
    T = similarity(rng)
    lies = [(texture(3), lying(3, 2.5), 0.2)]
    for tags, edge, why in (
        (lies, None, "tag 3 is in view, its edge is not known"),
        ([], 0.2, "no tag36h11 tag of known edge"),
    ):
        found = photographed(tmp_path, rng, tags, T, around(rng)[:3])
        alignment = align(found, tmp_path, options=AlignOptions(tag_edge=edge))
        assert not alignment.is_to_scale
        assert any(why in warning for warning in alignment.warnings)
        # They were 1.2 m above the floor, and are taken to be at 1.5.
        assert scale_off(alignment, T) == pytest.approx(1.5 / 1.2 - 1.0, abs=0.02)


def picks(found, point, T, names, rng):
    """Return where some shots show a point, to a pixel or so, as a hand picks it."""
    pixels = {}
    for shot in found.shots:
        x, y, z = shot.camera.T_camera_world[:3] @ T @ np.array([*point, 1.0])
        if shot.name in names and z > 0:
            c = shot.camera
            pixel = np.array([c.fx * x / z + c.cx, c.fy * y / z + c.cy])
            pixels[shot.name] = tuple(pixel + rng.normal(0, 0.7, 2))
    return pixels


def test_two_picked_points_give_the_scale_within_two_percent():
    rng = np.random.default_rng(6)
    T, poses = similarity(rng), around(rng)
    found = capture(room(rng), poses, T)
    names = [shot.name for shot in found.shots[:5]]
    length = KnownLength(
        first=picks(found, (3, 2.5, 0), T, names, rng),
        second=picks(found, (3.3, 2.6, 0.5), T, names, rng),
        metres=float(np.linalg.norm((0.3, 0.1, 0.5))),
    )
    alignment = align(found, None, options=AlignOptions(lengths=(length,)))
    assert abs(scale_off(alignment, T)) < 0.02
    assert alignment.scales[0].name == "length"


def test_two_points_of_known_distance_give_the_scale():
    rng = np.random.default_rng(7)
    T = similarity(rng)
    ends = [tuple(T[:3, :3] @ np.array(p) + T[:3, 3]) for p in ((1, 1, 0), (4, 5, 0))]
    length = KnownLength(first=ends[0], second=ends[1], metres=5.0)
    alignment = align(
        capture(room(rng), walk(rng), T), None, options=AlignOptions(lengths=(length,))
    )
    assert abs(scale_off(alignment, T)) < 1e-9


@pytest.mark.parametrize(
    ("first", "message"),
    [
        ({"nobody.jpg": (1, 1), "000.jpg": (2, 2)}, "not a shot of the capture"),
        ({"000.jpg": (10, 10)}, "000.jpg:9.5,9.5 is in one photograph, and there is no mesh"),
        ({"000.jpg": (10, 900)}, "is outside the photograph, which has 320 x 240 pixels"),
        ({"000.jpg": (10, 10), "004.jpg": (300, 10)}, "do not meet in a point"),
        ((1.0, 2.0, 3.0), "coincide"),
    ],
)
def test_picks_that_make_no_point_are_an_error(first, message):
    rng = np.random.default_rng(8)
    length = KnownLength(first=first, second=(1.0, 2.0, 3.0), metres=1.0)
    with pytest.raises(UsageError, match=message):
        align(capture(room(rng), walk(rng)), None, options=AlignOptions(lengths=(length,)))


def test_two_pixels_of_one_photograph_as_it_was_taken_give_the_scale_on_the_mesh():
    rng = np.random.default_rng(16)
    T, poses = similarity(rng), around(rng)
    found = capture(room(rng), poses, T)
    c = found.shots[0].camera
    lens = Lens(model="SIMPLE_RADIAL", width=640, height=480, params=(2 * c.fx, 320, 240, -0.1))
    found = replace(found, shots=(replace(found.shots[0], lens=lens), *found.shots[1:]))
    ends = []
    for point in ((3.0, 2.2, 0.0), (3.4, 2.7, 0.0)):
        local = c.T_camera_world[:3] @ T @ np.array([*point, 1.0])
        x, y = lens.camera().img_from_cam(local[None])[0] - 0.5
        ends.append(f"000.jpg:{x:.2f},{y:.2f}")
    vertices, faces = grid((-9, -9, 0), (18, 0, 0), (0, 18, 0), (1, 1))
    mesh = (vertices @ T[:3, :3].T + T[:3, 3], faces)
    length = KnownLength.of_words(*ends, float(np.hypot(0.4, 0.5)))
    alignment = align(found, None, mesh, AlignOptions(lengths=(length,)))
    assert abs(scale_off(alignment, T)) < 0.001  # Without the lens it would be 3 % off.
    assert alignment.scales[0].name == "length"
    assert "where each pixel is off by one" in alignment.scales[0].reason
    sky = KnownLength.of_words(ends[0], "000.jpg:320,0", 1.0)
    hole = (mesh[0], mesh[1][:0])
    with pytest.raises(UsageError, match=f"the point {ends[0]} does not meet the surface"):
        align(found, None, hole, AlignOptions(lengths=(sky,)))


def test_a_length_is_read_as_it_is_typed():
    typed = KnownLength.of_words("a:b 1.jpg:412,310", "IMG_1.jpg:1.5,2+IMG_2.jpg:3,4", 0.9)
    assert typed.first == {"a:b 1.jpg": (412.5, 310.5)}
    assert typed.second == {"IMG_1.jpg": (2.0, 2.5), "IMG_2.jpg": (3.5, 4.5)}
    assert words_of(typed.second) == "IMG_1.jpg:1.5,2+IMG_2.jpg:3,4"
    for wrong in ("IMG_1.jpg", "IMG_1.jpg:4", ":1,2", "a:1,2+", "a:1,2+a:3,4"):
        with pytest.raises(
            UsageError, match=r"is not a point of a photograph; .*IMG_1.jpg:412,310"
        ):
            KnownLength.of_words(wrong, "a:1,2", 1.0)


def test_gps_of_photographs_that_lie_near_together_gives_no_scale():
    rng = np.random.default_rng(9)
    poses = walk(rng)
    positions = {
        f"{i:03d}.jpg": tuple(spot)
        for i, spot in enumerate((poses[:, :3, 3] + rng.normal(0, 4.0, (40, 3))).tolist())
    }
    options = AlignOptions(positions=positions, positions_up="+z")
    alignment = align(capture(room(rng), poses), None, options=options)
    assert not alignment.is_to_scale
    assert any("the photographs lie too near together" in line for line in alignment.warnings)


def test_a_phones_positions_give_scale_and_up_whatever_a_few_of_them_say():
    rng = np.random.default_rng(9)
    T, poses = similarity(rng), walk(rng)
    spots = poses[:, [0, 2, 1], 3] * [1, 1, -1] + rng.normal(0, 0.01, (len(poses), 3))  # y is up.
    spots[::6] += rng.normal(0, 2.0, (7, 3))
    positions = {f"{i:03d}.jpg": tuple(spot) for i, spot in enumerate(spots.tolist())}
    options = AlignOptions(positions=positions, positions_up="+y")
    alignment = align(capture(room(rng), poses, T), None, options=options)
    assert abs(scale_off(alignment, T)) < 0.01
    by_positions = next(cue for cue in alignment.gravity if cue.name == "positions")
    assert by_positions.degrees < 2.0
    assert alignment.warnings == ()


def test_positions_of_two_shots_are_too_few():
    rng = np.random.default_rng(9)
    positions = {"000.jpg": (0.0, 0.0, 0.0), "001.jpg": (1.0, 0.0, 0.0)}
    with pytest.raises(UsageError, match="2 positions"):
        align(capture(room(rng), walk(rng)), None, options=AlignOptions(positions=positions))


def test_gps_becomes_metres_east_north_and_up():
    # One second of arc at 45 degrees north: 30.87 m of meridian, 21.90 m of parallel (NGA tables).
    second = 1 / 3600
    places = east_north_up(
        {
            "a": (45.0, 7.0, 200.0),
            "b": (45.0 + second, 7.0, 200.0),
            "c": (45.0, 7.0 + second, 210.0),
        }
    )
    assert places["a"] == (0.0, 0.0, 0.0)
    assert places["b"] == pytest.approx((0.0, 30.87, 0.0), abs=0.01)
    assert places["c"] == pytest.approx((21.90, 0.0, 10.0), abs=0.01)


def test_photographs_say_where_they_were_taken(tmp_path):
    gps = {1: "S", 2: (33.0, 30.0, 0.0), 3: "W", 4: (70.0, 36.0, 36.0), 5: b"\x00", 6: 500.0}
    files = {}
    for name, seconds in (("a.jpg", 36.0), ("b.jpg", 37.0)):
        exif = Image.Exif()
        exif.get_ifd(ExifTags.IFD.GPSInfo).update(gps | {4: (70.0, 36.0, seconds)})
        Image.new("RGB", (8, 8)).save(tmp_path / name, exif=exif)
        files[name] = tmp_path / name
    Image.new("RGB", (8, 8)).save(tmp_path / "without.jpg")
    (tmp_path / "broken.jpg").write_bytes(b"no picture")
    files |= {name: tmp_path / name for name in ("without.jpg", "broken.jpg", "absent.jpg")}
    places = gps_positions(files)
    assert set(places) == {"a.jpg", "b.jpg"}
    # A second of arc of the parallel at 33.5 degrees has 25.80 m.
    assert places["b.jpg"] == pytest.approx((-25.80, 0.0, 0.0), abs=0.02)


@pytest.mark.parametrize(
    ("heights", "known"), [((500.0, 501.0), 3), ((None, 501.0), 2), ((None, None), 3)]
)
def test_a_photograph_without_a_height_is_none_among_others_that_have_one(tmp_path, heights, known):
    files = {}
    for n, height in enumerate((*heights, heights[-1])):
        exif = Image.Exif()
        gps = {1: "N", 2: (47.0, 0.0, float(n)), 3: "E", 4: (8.0, 0.0, 0.0)}
        exif.get_ifd(ExifTags.IFD.GPSInfo).update(gps if height is None else gps | {6: height})
        Image.new("RGB", (8, 8)).save(tmp_path / f"{n}.jpg", exif=exif)
        files[f"{n}.jpg"] = tmp_path / f"{n}.jpg"
    places = gps_positions(files)
    assert len(places) == known
    assert max(abs(up) for *_, up in places.values()) < 1.1


def test_all_sources_count_and_those_that_are_known_better_count_more():
    rng = np.random.default_rng(10)
    T, poses = similarity(rng, 1.0), walk(rng)
    options = AlignOptions(camera_height=1.4, metric=True)  # It was 1.5.
    alignment = align(capture(room(rng), poses, T), None, options=options)
    # A phone's tracking is known better than the height at which somebody held it.
    assert [cue.name for cue in alignment.scales] == ["poses", "camera height"]
    assert 0.98 < alignment.scale < 1.0
    assert all(cue.used for cue in alignment.scales)
    assert 0.04 < alignment.scale_uncertain < 0.07
    assert alignment.warnings == ()


def test_two_sources_that_contradict_each_other_stop_and_a_third_decides():
    rng = np.random.default_rng(10)
    poses, points = walk(rng), room(rng)
    wrong = AlignOptions(camera_height=0.3, metric=True)  # It was 1.5.
    with pytest.raises(SceneError, match="sources contradict each other") as stopped:
        align(capture(points, poses), None, options=wrong)
    assert "poses says 1 m a unit, known to 4%" in str(stopped.value)
    assert "camera height says 0.202 m a unit, known to 12%" in str(stopped.value)
    length = KnownLength(first=(1.0, 1.0, 0.0), second=(4.0, 5.0, 0.0), metres=5.05)
    decided = align(capture(points, poses), None, options=replace(wrong, lengths=(length,)))
    assert decided.is_to_scale
    assert [cue.name for cue in decided.scales if cue.used] == ["length", "poses"]
    (said,) = decided.warnings
    assert said.startswith("camera height says 0.202 m")


@pytest.mark.parametrize(
    ("points", "why"),
    [
        ({"floor": 0}, "no level floor was found"),
        ({"floor": 0, "ramp": 900, "slope": 5.0, "walls": 900}, "slopes by 4.6"),
    ],
)
def test_a_height_gives_a_scale_over_a_level_floor_that_was_seen_only(points, why):
    rng = np.random.default_rng(13)
    found = capture(room(rng, **points), walk(rng))
    alignment = align(found, None, options=AlignOptions(camera_height=1.5))
    assert not alignment.is_to_scale
    (said,) = [line for line in alignment.warnings if "the cameras' height gives no scale" in line]
    assert why in said


def ledge(rng, share):
    """Return points of a facade with a ledge 0.2 m below the cameras, and of ground far below."""
    count = int(2000 * share)
    parts = [
        patch(rng, 2000 - count, (0, 4, -3), (6, 0, 0), (0, 0, 5)),
        patch(rng, count, (1, 3.5, 1.3), (4, 0, 0), (0, 0.5, 0)),
        rng.uniform((0, 0, -1.5), (6, 4, 1.2), (160, 3)),
    ]
    return np.concatenate(parts) + rng.normal(0, 0.004, (2160, 3))


@pytest.mark.parametrize("share", [0.02, 0.05, 0.3])
def test_a_ledge_is_not_a_floor_from_which_a_camera_height_gives_a_scale(share):
    rng = np.random.default_rng(11)
    T, poses = similarity(rng), straight(rng, 12, pitch=5.0)
    found = capture(ledge(rng, share), poses, T)
    alignment = align(found, None, options=AlignOptions(camera_height=1.5))
    assert not alignment.is_to_scale
    gps = {f"{i:03d}.jpg": tuple(4.0 * pose[:3, 3]) for i, pose in enumerate(poses)}
    options = AlignOptions(camera_height=1.5, positions=gps, positions_up="+z", positions_error=5.0)
    both = align(found, None, options=options)
    assert not both.is_to_scale  # Over 17 m GPS knows it to a third, and the ledge to nothing.
    assert any("photographs lie too near together" in line for line in both.warnings)


def test_scales_by_positions_are_as_near_as_they_claim():
    rng = np.random.default_rng(12)
    within = []
    for _ in range(30):
        count, span = int(rng.integers(3, 30)), rng.uniform(20, 200)
        centres = rng.normal(0, span / 3, (count, 3)) * (1, rng.choice([0.05, 1]), 0.05)
        drift = rng.normal(0, 5.0, 3) / np.sqrt(3) * (centres[:, :1] / span)  # Of GPS on a walk.
        metres = centres + rng.normal(0, 5.0 / np.sqrt(3), (count, 3)) + drift
        fit = fit_positions(centres / 3.0, metres, rng, error=5.0)
        within.append(abs(np.log(fit.scale / 3.0)) <= 1.645 * fit.uncertain)
    assert np.mean(within) >= 0.9


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_lengths_have_to_be_positive(value):
    for options in ({"tag_edge": value}, {"camera_height": value}):
        with pytest.raises(UsageError, match="more than 0"):
            AlignOptions(**options)


def test_a_point_is_triangulated_though_half_of_the_shots_are_mistaken():
    rng = np.random.default_rng(12)
    found = capture(np.zeros((1, 3)), around(rng))
    here = picks(found, (3.2, 2.4, 0.3), np.eye(4), [s.name for s in found.shots], rng)
    pixels = np.array([here[shot.name] for shot in found.shots])[:, None]
    pixels[::2] += rng.uniform(15, 80, (4, 1, 2))
    answer = triangulate([shot.camera for shot in found.shots], pixels, tolerance=3.0)
    np.testing.assert_allclose(answer.points[0], (3.2, 2.4, 0.3), atol=0.01)
    assert answer.used.tolist() == [False, True] * 4
