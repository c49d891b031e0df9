"""Courses: drawn from the seed alone, harder by level, and never those of the evaluation."""

import numpy as np
import pytest
from pydantic import ValidationError

from nw_learn.teacher.config import GROUNDS, CourseSettings
from nw_learn.teacher.lanes import CELL, ORIGIN, SOLIDS, Lanes, draw_course, lane_of
from nw_places.splits import EVALUATION
from nw_scenes.rays import RayScene
from nw_sim.catalogue import get_scene, names

HARDEST = {
    "hurdles": lambda scene: max(point[2] for point in scene.trail),
    "gaps": lambda scene: max(np.diff(sorted(sides(scene)))[1::2]),
    "ramps": lambda scene: max(2 * np.arccos(abs(solid.quat[0])) for solid in scene.solids),
    "stairs": lambda scene: scene.trail[:, 2].max(),
}


def sides(scene):
    """Return where platforms begin and end along x."""
    tops = [box for box in scene.solids if box.center[2] + box.half_size[2] > -0.01]
    return [box.center[0] + side * box.half_size[0] for box in tops for side in (-1, 1)]


@pytest.mark.parametrize("ground", GROUNDS[:4])
def test_courses_are_harder_by_level(ground):
    easy, hard = (
        np.mean([HARDEST[ground](draw(ground, level, seed)) for seed in range(6)])
        for level in (1, 9)
    )
    assert hard > 1.5 * easy


def draw(ground, level, seed):
    return draw_course(ground, level, np.random.default_rng(seed))


@pytest.mark.parametrize("ground", GROUNDS)
def test_every_course_of_every_level_fits_a_lane(ground, trained_robot):
    sizes = {lane_of(draw(ground, level, level), trained_robot).model.ngeom for level in (0, 5, 11)}
    assert len(sizes) == 1


def test_every_training_scene_fits_a_lane_with_all_boxes_that_a_robot_can_reach(trained_robot):
    for name in ("gaps/three_pallets_warehouse", "stairs/seven_steel_warehouse"):
        lane_of(get_scene(name), trained_robot)
    scene = get_scene("hurdles/three_high_wood_hall")
    model = lane_of(scene, trained_robot).model
    tops = [
        model.geom(f"solid_{index}").pos[2] + model.geom(f"solid_{index}").size[2]
        for index in range(SOLIDS)
    ]
    assert sorted(round(top, 2) for top in tops if top > 0) == [0.3, 0.33, 0.36]


def test_heights_are_what_rays_meet_and_edges_are_where_they_jump(trained_robot):
    scene = get_scene("hurdles/three_high_wood_hall")
    lane = lane_of(scene, trained_robot)
    rng = np.random.default_rng(0)
    cells = np.stack([rng.integers(0, 400, 50), rng.integers(60, 140, 50)], axis=1)
    points = np.array(ORIGIN) + CELL * (cells + 0.5)
    assert lane.heights[tuple(cells.T)] == pytest.approx(RayScene(scene.mesh()).height(points))
    along = lane.edges[:, 100]  # The bars begin at 1.49 m.
    first = np.flatnonzero(along)[0]
    assert ORIGIN[0] + CELL * first == pytest.approx(1.49 - 0.05, abs=CELL)
    assert 0.02 < along.mean() < 0.1


@pytest.mark.nightly  # One of each task is built in the tests above and below.
def test_every_training_scene_is_trained_in(trained_robot):
    settings = {"variants": 1, "levels": 1, "start": [0, 0]}
    found = Lanes(CourseSettings.model_validate(settings), trained_robot, seed=1)
    assert found.scenes == names("train")
    assert len(found.models) == 5 + len(found.scenes)


def test_scenes_are_those_of_the_training_split_alone():
    without_course = {"flat/carpet_room", *(name for name in names() if name.startswith("open/"))}
    assert set(names("train")) | set(EVALUATION) | without_course == set(names())
    assert not set(names("train")) & set(EVALUATION)
    faults = {"hurdles/three_low": "kept for evaluation", "a/b": "not a training scene"}
    for name, fault in faults.items():
        with pytest.raises(ValidationError, match=fault):
            CourseSettings.model_validate({"scenes": [name]})


def test_courses_follow_from_the_seed_and_a_redrawn_one_from_how_often_it_was(trained_robot):
    settings = CourseSettings.model_validate(
        {"variants": 1, "levels": 1, "start": [0, 0], "scenes": ["ramps/one_ramp_plaza"]}
    )
    first = Lanes(settings, trained_robot, seed=7)
    before = first.heights[1].copy()
    first.redraw(1)
    assert (first.heights[1] != before).any()
    assert GROUNDS[first.grounds[1]] == "gaps"
    again = Lanes(settings, trained_robot, seed=7, generations=first.generations)
    assert (again.heights == first.heights).all()
    assert (Lanes(settings, trained_robot, seed=8).heights != first.heights).any()
