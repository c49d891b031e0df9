"""Every change of a labelling is a new state; each can be gone back to, and forth again."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from label_places import block, floor, opened, photographed, without_waypoints

from nw_base.errors import SceneError, UsageError
from nw_twin.label.labelling import open_labelling
from nw_twin.label.state import CropBox, StartPose

near = st.floats(-1.5, 1.5)
points = st.tuples(st.floats(-1.5, 6), near, st.just(0.0))
changes = st.one_of(
    st.tuples(st.just("turn"), st.sampled_from("xyz"), near),
    st.tuples(st.just("shift"), near, near, near),
    st.tuples(st.just("scale_to"), st.floats(0.5, 2)),
    st.tuples(
        st.just("crop_to"), st.just(CropBox(low=(-99.0, -99.0, -99.0), high=(99.0, 99.0, 99.0)))
    ),
    st.tuples(st.just("mark"), points),
    st.tuples(st.just("clear_markers")),
    st.tuples(st.just("set_unit"), st.sampled_from(["m", "cm", "feet"])),
    st.tuples(st.just("flip")),
    st.tuples(st.just("click_floor"), points),
    st.tuples(st.just("add_waypoint"), points),
    st.tuples(st.just("add_waypoint")),
    st.tuples(st.just("move_waypoint"), st.integers(-1, 3), points),
    st.tuples(st.just("nudge_waypoint"), st.integers(0, 3), near, near),
    st.tuples(st.just("remove_waypoint"), st.integers(0, 3)),
    st.tuples(st.just("reorder_waypoint"), st.integers(0, 3), st.integers(0, 3)),
    st.tuples(st.just("set_start"), points),
    st.tuples(st.just("set_yaw"), near),
    st.tuples(st.just("nudge_start"), near, near),
    st.tuples(st.just("start_before_trail")),
    st.tuples(st.just("set_task"), st.sampled_from(["hurdles", "gaps", "ramps"])),
)


def do(labelling, change):
    name, *words = change
    try:
        getattr(labelling, name)(*words)
    except UsageError:
        return False
    return True


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("states")


@pytest.fixture
def labelling(tmp_path):
    return opened(tmp_path)


@settings(max_examples=20)
@given(steps=st.lists(changes, max_size=6), last=changes)
def test_undo_gives_back_the_state_before_and_redo_the_one_after(folder, steps, last):
    labelling = opened(folder)
    for step in steps:
        do(labelling, step)
    before, mesh = labelling.state, labelling.mesh.vertices
    do(labelling, last)
    after = labelling.state
    if after != before:
        labelling.undo()
        assert labelling.state == before
        np.testing.assert_array_equal(labelling.mesh.vertices, mesh)
        labelling.redo()
    assert labelling.state == after
    while labelling.can_undo:
        labelling.undo()
    assert labelling.state == labelling.place.state


@settings(max_examples=20)
@given(step=changes)
def test_what_cannot_be_done_changes_nothing(folder, step):
    labelling = opened(folder)
    before = labelling.state
    assert do(labelling, step) or labelling.state == before


def test_after_an_undo_a_new_change_forgets_what_was_undone(labelling):
    labelling.set_task("gaps")
    labelling.undo()
    labelling.set_task("ramps")
    assert not labelling.can_redo


def test_two_markers_and_a_distance_scale_the_place_with_all_that_is_on_it(labelling):
    labelling.mark((2.0, 0.0, 0.1))
    labelling.mark((3.0, 0.0, 0.1))
    assert labelling.distance == pytest.approx(1.0)
    labelling.scale_to(0.5)
    assert labelling.distance == pytest.approx(0.5)
    assert np.ptp(labelling.mesh.vertices[:, 0]) == pytest.approx(4.5)
    assert labelling.state.waypoints[0] == pytest.approx((1.25, 0.0, 0.05))
    assert labelling.T_world_splat[0, 0] == pytest.approx(0.5)


def test_a_third_marker_takes_the_place_of_the_first_and_one_scales_nothing(labelling):
    labelling.mark((0.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="two markers"):
        labelling.scale_to(1.0)
    for x in (1.0, 3.0):
        labelling.mark((x, 0.0, 0.0))
    assert labelling.distance == pytest.approx(2.0)


def test_start_and_trail_turn_with_the_place(labelling):
    labelling.set_start((0.0, 0.0, 0.0), 0.0)
    labelling.turn("z", math.pi / 2)
    # The middle of the place is at x = 2.5, y = 0.
    assert labelling.start.position == pytest.approx((2.5, -2.5, 0.0))
    assert labelling.start.yaw == pytest.approx(math.pi / 2)
    assert labelling.state.waypoints[1] == pytest.approx((2.5, 2.0, 0.0))


def test_a_crop_follows_the_place_and_its_sides_stay_along_the_axes(labelling):
    labelling.crop_to(CropBox(low=(-1.0, -1.0, -1.0), high=(3.0, 1.0, 1.0)))
    labelling.shift(1.0, 0.0, 0.5)
    assert labelling.state.crop == CropBox(low=(0.0, -1.0, -0.5), high=(4.0, 1.0, 1.5))
    assert labelling.mesh.vertices[:, 0].max() == pytest.approx(4.0)


def test_a_crop_that_leaves_nothing_is_refused(labelling):
    with pytest.raises(UsageError, match="nothing"):
        labelling.crop_to(CropBox(low=(50.0, 50.0, 50.0), high=(51.0, 51.0, 51.0)))
    with pytest.raises(UsageError, match="nothing"):
        CropBox(low=(0.0, 0.0, 0.0), high=(1.0, 0.0, 1.0))


def test_by_default_the_robot_starts_1_m_before_the_trail_looking_along_it(labelling):
    labelling.start_before_trail()
    assert labelling.start == StartPose(position=(1.5, 0.0, 0.0), yaw=0.0)
    labelling.move_waypoint(1, (2.5, 2.0, 0.0))
    assert labelling.start.position == pytest.approx((2.5, -1.0, 0.1))
    assert labelling.start.yaw == pytest.approx(math.pi / 2)
    labelling.set_start((2.5, 3.0, 0.0))  # Without a yaw it looks at the first waypoint.
    assert labelling.start.yaw == pytest.approx(-math.pi / 2)


def test_a_waypoint_without_a_place_comes_1_m_on_along_the_trail(labelling):
    labelling.add_waypoint()
    assert labelling.state.waypoints[-1] == pytest.approx((5.5, 0.0, 0.0))
    labelling.add_waypoint(index=0, point=(1.0, 0.0, 0.0))
    assert labelling.state.waypoints[0] == (1.0, 0.0, 0.0)


def test_waypoints_change_their_order_and_are_nudged_over_the_ground_up_the_step(labelling):
    first, second = labelling.state.waypoints
    labelling.reorder_waypoint(1, 0)
    assert labelling.state.waypoints == (second, first)
    labelling.undo()
    labelling.nudge_waypoint(1, -1.6, 0.0)
    assert labelling.state.waypoints[1] == pytest.approx((2.9, 0.0, 0.1))
    with pytest.raises(UsageError, match="no ground"):
        labelling.nudge_waypoint(1, 30.0, 0.0)


def test_a_place_of_boxes_is_not_moved_but_its_trail_is(labelling):
    folder = labelling.place.folder
    (folder / "collision.yaml").write_text(
        "boxes:\n  - {center: [2.5, 0, 0.05], half_size: [0.5, 1.5, 0.05]}\n"
    )
    text = (folder / "scene.yaml").read_text().replace("collision.ply", "collision.yaml")
    (folder / "scene.yaml").write_text(text)
    labelling = open_labelling(folder)
    with pytest.raises(UsageError, match="boxes"):
        labelling.shift(1.0, 0.0, 0.0)
    labelling.nudge_waypoint(1, 0.5, 0.0)
    labelling.save()
    assert open_labelling(folder).state.waypoints[1] == pytest.approx((5.0, 0.0, 0.0))


def test_where_the_camera_walked_a_trail_over_the_bar_is_proposed_as_one_change(tmp_path):
    labelling = photographed(tmp_path, floor(), block(2.0, 0.2, 0.2))
    before = labelling.state
    words = labelling.propose_along_walk()
    assert "a bar 0.20 m high" in words
    assert labelling.course.task == "hurdles"
    on_bar, behind = labelling.state.waypoints
    assert on_bar == pytest.approx((2.1, 0.2, 0.2), abs=0.03)
    assert behind[0] > 3.0
    assert labelling.start.position == pytest.approx((0.5, 0.2, 0.0), abs=0.03)  # 1.5 m before it.
    labelling.undo()
    assert labelling.state == before


def test_the_walk_turns_and_scales_with_the_place(tmp_path):
    labelling = photographed(tmp_path, floor(), block(2.0, 0.2, 0.2))
    labelling.turn("z", math.pi / 2)
    labelling.mark((0.0, 0.0, 0.0))
    labelling.mark((1.0, 0.0, 0.0))
    labelling.scale_to(1.1)
    labelling.propose_along_walk()
    on_bar, behind = labelling.state.waypoints
    assert on_bar[2] == pytest.approx(0.22, abs=0.01)
    assert behind[0] == pytest.approx(on_bar[0], abs=0.05)
    assert behind[1] > on_bar[1] + 1.0
    assert labelling.start.yaw == pytest.approx(math.pi / 2, abs=0.01)


def test_without_cameras_a_trail_is_proposed_along_two_clicks(tmp_path):
    labelling = opened(tmp_path, floor(), block(2.0, 0.2, 0.2))
    with pytest.raises(UsageError, match="this scene has no camera positions"):
        labelling.propose_along_walk()
    without_waypoints(labelling)
    labelling.set_start((-1.0, 0.0, 0.0), 0.0)
    labelling.add_waypoint((5.0, 0.0, 0.0))
    labelling.propose_along_trail()
    assert labelling.state.waypoints[0] == pytest.approx((2.1, 0.0, 0.2), abs=0.03)
    assert labelling.state.waypoints[-1][2] == 0.0


def test_a_trail_of_nothing_is_not_proposed_along(labelling):
    labelling.set_start((2.5, 0.0, 0.1), 0.0)
    labelling.remove_waypoint(1)
    with pytest.raises(UsageError, match="put waypoints a metre or more away"):
        labelling.propose_along_trail()
    labelling.remove_waypoint(0)
    with pytest.raises(UsageError, match="no waypoint"):
        labelling.propose_along_trail()


def test_a_waypoint_gets_a_marker_or_becomes_the_start_that_looks_at_the_next(labelling):
    labelling.mark_waypoint(0)
    labelling.mark_waypoint(1)
    assert labelling.distance == pytest.approx(math.dist(*labelling.state.waypoints))
    labelling.add_waypoint((2.5, 2.0, 0.1), index=1)
    labelling.start_at_waypoint(0)
    assert labelling.start.position == (2.5, 0.0, 0.1)
    assert labelling.start.yaw == pytest.approx(math.pi / 2)
    assert len(labelling.state.waypoints) == 2


def test_it_knows_whether_there_is_something_to_save(labelling):
    assert labelling.is_saved
    labelling.mark((0.0, 0.0, 0.0))
    assert labelling.is_saved  # Markers measure; they are of no file.
    labelling.nudge_waypoint(1, 0.1, 0.0)
    assert not labelling.is_saved
    labelling.save()
    assert labelling.is_saved
    labelling.undo()
    assert not labelling.is_saved


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_numbers_that_are_none_change_nothing(labelling, number):
    for change in (
        lambda: labelling.turn("z", number),
        lambda: labelling.shift(0.0, number, 0.0),
        lambda: labelling.set_yaw(number),
        lambda: labelling.nudge_waypoint(0, number, 0.0),
        lambda: labelling.mark((number, 0.0, 0.0)),
    ):
        with pytest.raises((UsageError, SceneError)):
            change()
    assert not labelling.can_undo


def test_three_clicks_on_the_floor_lay_it_level_at_zero_in_one_step(labelling):
    labelling.turn("x", 0.2)
    labelling.turn("y", -0.3)
    labelling.shift(0.0, 0.0, 1.7)
    tilted = labelling.state.placement.matrix
    corners = [(tilted @ [*spot, 1.0])[:3] for spot in ((0, 2, 0), (6, 2, 0), (5, -2, 0))]
    for corner in corners[:2]:
        labelling.click_floor(tuple(corner.tolist()))
    assert len(labelling.state.floor) == 2
    with pytest.raises(UsageError, match="lie along a line"):
        labelling.click_floor(tuple((0.7 * corners[0] + 0.3 * corners[1]).tolist()))
    labelling.click_floor(tuple(corners[2].tolist()))
    heights = labelling.mesh.vertices[:, 2]
    np.testing.assert_allclose(np.unique(heights.round(9)), [-0.2, 0.0, 0.1], atol=1e-6)
    assert labelling.state.floor == ()
    labelling.undo()
    np.testing.assert_allclose(labelling.state.placement.matrix, tilted)


def test_a_place_that_is_flipped_stands_on_the_same_plane(labelling):
    before = labelling.mesh.vertices
    labelling.flip()
    after = labelling.mesh.vertices
    np.testing.assert_allclose(after[:, 2], -before[:, 2], atol=1e-9)
    np.testing.assert_allclose(after[:, 0], before[:, 0], atol=1e-9)  # A turn, no mirror.
    np.testing.assert_allclose(after[:, 1], -before[:, 1], atol=1e-9)
    labelling.flip()
    np.testing.assert_allclose(labelling.mesh.vertices, before, atol=1e-9)


@pytest.mark.parametrize(("unit", "metres"), [("inch", 0.0254), ("feet", 0.3048), ("m", 1.0)])
def test_the_unit_of_a_scan_counts_from_the_file_however_often_it_is_chosen(
    labelling, unit, metres
):
    for each in ("mm", "cm", unit, unit):
        labelling.set_unit(each)
    size = np.ptp(labelling.mesh.vertices[:, 0])
    assert size == pytest.approx(9.0 * metres)
    assert labelling.state.waypoints[0] == pytest.approx((2.5 * metres, 0.0, 0.1 * metres))
