"""A stage goes on from where it stands, whatever is done to its robot and its place."""

import numpy as np
import pytest

import nw_eval
from nw_base.errors import UsageError
from nw_eval.suite import load_suite
from nw_eval.view.live_page import save_played
from nw_eval.view.live_stage import open_stage, painted
from nw_scenes.folder import load_folder
from nw_scenes.rays import RayScene
from nw_sim.axes import AXES, COMMANDED, Perturb
from nw_splat.gaussians import SH0

PLACE = "hurdles/one_low_carpet"


@pytest.fixture
def stage():
    with open_stage("go1-parkour", PLACE) as stage:
        yield stage


def walk(stage, steps):
    """Return where the robot is after so many control steps, or at the trial's end."""
    for _ in range(steps):
        if stage.step()[1] is not None:
            break
    return stage.trial.episode.world.trunk_position.copy()


def picture(stage):
    """Return what the policy sees now."""
    seen = stage.trial.episode.decide().observation
    return next(array for array in seen.values() if array.ndim > 2)


def test_a_change_that_changes_nothing_leaves_every_bit(stage):
    walk(stage, 40)
    with open_stage("go1-parkour", PLACE) as other:
        walk(other, 40)
        other.perturb({"payload": 0.0, "latency": 0.0})
        other.move_goal(*other.original.trail[-1, :2])
        np.testing.assert_array_equal(walk(other, 60), walk(stage, 60))
        assert other.cell == {}


@pytest.mark.parametrize("axis", sorted(set(AXES) - {"push", *COMMANDED}))
def test_every_axis_can_be_moved_while_it_walks(axis):
    least, most, _ = AXES[axis].slides
    with open_stage("go1-act-rgb", PLACE) as stage:
        assert set(stage.axes) == set(AXES) - set(COMMANDED), "a course has no command"
        before = walk(stage, 12)
        for value in (least, most):
            stage.perturb({axis: value})
            assert stage.trial.episode.step == 12
            np.testing.assert_array_equal(stage.trial.episode.world.trunk_position, before)
        walk(stage, 4)
        Perturb(**{axis: (least, most)})  # A suite may name both.


def test_what_a_policy_cannot_feel_is_not_offered(stage):
    assert "friction" in stage.axes
    assert "fog" not in stage.axes


def test_it_is_said_when_a_trial_of_a_run_would_have_ended():
    with open_stage("stand", PLACE) as stage:
        walk(stage, 100)
        assert stage.run_end is None
        # It is stuck after 4 s in a run, and stands here as long as one likes.
        walk(stage, 130)
        assert stage.trial.episode.step == 230
        assert stage.run_end == (pytest.approx(4.0), "stuck", "no progress")
        stage.restart()
        assert stage.run_end is None


def test_the_time_limit_of_a_run_ends_no_play_and_is_said(stage):
    stage._limit = 0.2
    walk(stage, 30)
    assert stage.trial.episode.step == 30
    assert stage.run_end == (pytest.approx(0.2), "timeout", "0.2 s")


def test_a_push_moves_the_robot_its_own_way(stage):
    walk(stage, 25)
    world = stage.trial.episode.world
    yaw = world.roll_pitch_yaw[2]
    before = world.trunk_linear_velocity.copy()
    stage.push(0.0, 0.7)
    added = world._data.qvel[:2] - before[:2]
    np.testing.assert_allclose(added, [-0.7 * np.sin(yaw), 0.7 * np.cos(yaw)], atol=1e-9)
    assert stage.pushed == pytest.approx(0.7)


def test_a_box_stands_in_its_way_for_feet_rays_and_cameras():
    with open_stage("go1-act-rgb", PLACE) as stage:
        walk(stage, 2)
        stage.drop_box()
        (box,) = stage.place.boxes
        scene = stage.trial.scene
        assert box in scene.solids
        height = RayScene(scene.mesh()).height(np.array([box.center[:2]]))
        assert height[0] == pytest.approx(box.center[2] + box.half_size[2])
        stage.restart()
        seen = picture(stage)
        stage.clear_boxes()
        stage.restart()
        assert (seen != picture(stage)).mean() > 0.02
        assert stage.trial.scene.solids == stage.original.solids


def test_a_robot_that_walks_against_a_box_does_not_pass_it_as_if_nothing_were_there(stage):
    free = walk(stage, 60)
    stage.restart()
    stage.drop_box()
    assert np.linalg.norm(walk(stage, 60) - free) > 0.05


def test_a_robot_goes_to_where_the_goal_was_moved(stage):
    x, y = stage.original.trail[-1, :2]
    stage.move_goal(float(x), float(y) + 0.8)
    end = walk(stage, 400)
    assert stage.trial.episode.task.reached == 2
    assert end[1] > y + 0.4


def test_starting_again_keeps_what_was_changed(stage):
    walk(stage, 30)
    stage.perturb({"friction": 0.4})
    stage.restart()
    assert stage.trial.episode.step == 0
    assert stage.cell == {"friction": 0.4}


def test_what_was_done_is_saved_as_a_suite_that_runs(stage, tmp_path):
    walk(stage, 5)
    stage.perturb({"payload": 2.0})
    stage.push(0.3, 0.4)
    stage.drop_box()
    folder = tmp_path / "played"
    suite = load_suite(save_played(stage, folder))
    assert (suite.perturb.payload, suite.perturb.push) == ((2.0,), (0.5,))
    place = load_folder(folder)
    assert len(place.solids) == len(stage.original.solids) + 1
    assert place.spawn == stage.original.spawn
    report = nw_eval.run(
        folder / "suite.yaml", trials=1, out=tmp_path / "run", in_process=True, record="none"
    )
    (row,) = report.rows
    assert dict(row.perturbation) == {"payload": 2.0, "push": 0.5}
    with pytest.raises(UsageError, match="is there already"):
        save_played(stage, folder)


def test_a_place_that_was_not_changed_is_named_and_not_copied(stage, tmp_path):
    stage.perturb({"friction": 0.5})
    suite = load_suite(save_played(stage, tmp_path / "played"))
    assert suite.scenes == (PLACE,)
    assert [path.name for path in (tmp_path / "played").iterdir()] == ["suite.yaml"]


def test_gaussians_of_a_box_lie_on_its_faces_and_are_lit_from_above(stage):
    walk(stage, 1)
    stage.drop_box()
    (box,) = stage.place.boxes
    splat = painted([box], 4)
    assert splat.sh.shape[1] == 4
    off = np.abs(splat.means - np.array(box.center)) / 1.0
    assert (off.max(axis=0) < np.linalg.norm(box.half_size)).all()
    top = splat.means[:, 2] > box.center[2] + box.half_size[2] - 1e-4
    light = 0.5 + SH0 * splat.sh[:, 0].mean(axis=1)
    assert light[top].min() > light[~top].max()
