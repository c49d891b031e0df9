from __future__ import annotations

import subprocess
import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest

from nw_base.errors import SceneError
from nw_places.splits import EVALUATION
from nw_sim.catalogue import (
    _BY_NAME,
    get_scene,
    match_scenes,
    names,
    references,
    scene_files,
    scene_paths,
)


def _hurdles():
    return [get_scene(name) for name in names() if name.startswith("hurdles/")]


def _heights(scene):
    return [box.half_size[2] * 2 for box in scene.solids if box.kind == "obstacle"]


def test_names_are_sorted_and_each_scene_bears_its_own():
    assert list(names()) == sorted(names())
    assert [get_scene(name).name for name in names()] == list(names())


def test_there_are_sixteen_scenes_of_each_task_an_empty_place_and_three_wide_grounds():
    tasks = Counter(name.split("/")[0] for name in names())
    assert tasks == {"hurdles": 16, "gaps": 16, "ramps": 16, "stairs": 16, "flat": 1, "open": 3}
    for name in names():
        assert name.startswith((get_scene(name).task, "flat/"))


def test_scenes_are_indoors_and_outdoors_by_day_at_dusk_and_at_night():
    entries = [_BY_NAME[name] for name in names()]
    for task in ("hurdles", "gaps", "ramps", "stairs"):
        mine = [entry for entry in entries if entry.task == task]
        assert {entry.setting.indoor for entry in mine} == {True, False}
        lights = {entry.light for entry in mine}
        assert {"dusk", "night"} <= lights, task
        assert lights & {"noon", "morning", "afternoon"}, task
    assert {"indoor_evening", "indoor_night"} <= {entry.light for entry in entries}


def test_titles_are_told_once_and_fit_a_line():
    titles = [get_scene(name).title for name in names()]
    assert len(set(titles)) == len(titles)
    assert max(map(len, titles)) <= 90


def test_the_split_is_about_70_to_30_in_each_task_and_whole():
    assert set(names("train")) | set(names("eval")) == {
        name for name in names() if not name.startswith(("flat/", "open/"))
    }
    assert not set(names("train")) & set(names("eval"))
    for task in ("hurdles", "gaps", "ramps", "stairs"):
        assert sum(name.startswith(task) for name in names("eval")) == 5
    assert set(EVALUATION) <= set(names())


def test_suites_can_name_a_split():
    found = [scene.name for scene in match_scenes(["split:eval", "gaps/*"])]
    assert found[:20] == list(names("eval"))
    assert len(found) == 20 + 11
    with pytest.raises(SceneError, match="did you mean 'split:eval'"):
        match_scenes(["split:evl"])


def test_hurdle_scenes_have_one_to_three_bars_between_10_and_36_cm():
    scenes = _hurdles()
    assert len(scenes) >= 10
    for scene in scenes:
        heights = _heights(scene)
        assert 1 <= len(heights) <= 3, scene.name
        assert all(0.10 - 1e-9 <= height <= 0.36 + 1e-9 for height in heights), scene.name


def test_most_hurdle_scenes_stay_below_25_cm_and_two_reach_30():
    tallest = [max(_heights(scene)) for scene in _hurdles()]
    assert sum(height <= 0.25 for height in tallest) > len(tallest) / 2
    assert sum(height >= 0.30 - 1e-9 for height in tallest) >= 2


def test_bars_have_the_dimensions_that_the_shipped_policy_was_trained_on():
    # prototypes: make_lane, task 0: length 0.28..0.45 m, width 1.0..2.4 m, first bar at
    # 1.2..1.9 m, then 1.5..2.1 m from bar to bar.
    for scene in _hurdles():
        bars = [box for box in scene.solids if box.kind == "obstacle"]
        for bar in bars:
            assert 0.28 - 1e-9 <= 2 * bar.half_size[0] <= 0.45 + 1e-9, scene.name
            assert 1.0 - 1e-9 <= 2 * bar.half_size[1] <= 2.4 + 1e-9, scene.name
        x = [bar.center[0] for bar in bars]
        assert 1.2 <= x[0] <= 1.9, scene.name
        assert all(1.5 - 1e-9 <= b - a <= 2.1 + 1e-9 for a, b in pairwise(x))


def test_an_unknown_name_gets_the_nearest_one():
    with pytest.raises(SceneError, match="did you mean 'hurdles/three_low'"):
        get_scene("hurdles/thre_low")


def test_a_pattern_that_matches_nothing_gets_the_nearest_name():
    with pytest.raises(SceneError, match=r"no scene matches 'hurdle/three_low\*'.*three_low"):
        match_scenes(["hurdle/three_low*"])


def test_an_empty_pattern_is_refused():
    with pytest.raises(SceneError, match="empty"):
        match_scenes([""])


def test_globs_give_pattern_order_then_names_and_no_scene_twice():
    scenes = match_scenes(["hurdles/two_*", "flat/*", "hurdles/*"])
    found = [scene.name for scene in scenes]
    two = sorted(name for name in names() if name.startswith("hurdles/two_"))
    assert found[: len(two)] == two
    assert found[len(two)].startswith("flat/")
    assert sorted(found) == sorted(set(found))
    assert len(found) == 17


def test_hurdles_glob_leaves_the_flat_scene_out():
    assert all(scene.name.startswith("hurdles/") for scene in match_scenes(["hurdles/*"]))
    assert not [box for box in get_scene("flat/carpet_room").solids if box.kind == "obstacle"]


def test_scene_folders_match_by_relative_and_absolute_globs(tmp_path: Path):
    for name in ("b", "a"):
        folder = tmp_path / "places" / name
        folder.mkdir(parents=True)
        (folder / "scene.yaml").write_text(
            f"nw-scene: 1\nname: mine/{name}\ntask: hurdles\nlicence: MIT\ntrail: [[1, 0, 0]]\n"
            "collision: boxes.yaml\n"
        )
        (folder / "boxes.yaml").write_text("boxes: []\n")
    expected = ["mine/a", "mine/b"]
    assert [scene.name for scene in match_scenes(["places/*"], tmp_path)] == expected
    assert [scene.name for scene in match_scenes([f"{tmp_path}/places/*"])] == expected
    folders = [str((tmp_path / "places" / name).resolve()) for name in ("a", "b")]
    assert references(["places/*"], tmp_path) == tuple((path, "terrain") for path in folders)


def test_listing_and_opening_scenes_loads_no_heavy_library():
    code = (
        "import sys; import nw_sim.catalogue as s; [s.get_scene(n).digest for n in s.names()];"
        "print([m for m in ('numba','torch','mujoco','matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["hurdles/two_logs_park", "hurdles/two_logs_park~2"])
def test_a_built_in_scene_and_its_variants_have_no_files(name):
    assert scene_paths(name) == ()
    assert scene_files(name) is None
