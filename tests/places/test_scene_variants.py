"""Variants: the course of a scene in another's place, of the same split."""

from dataclasses import fields

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_places.entries import ENTRIES, has_variants, parted, variant
from nw_places.splits import split_of
from nw_sim.catalogue import get_scene, names, references

BY_NAME = {entry.name: entry for entry in ENTRIES}
EVERY = [(name, number) for name in BY_NAME if has_variants(name) for number in (1, 2, 3)]


def test_obstacles_have_the_sizes_of_the_scene_and_materials_of_its_kind():
    for name, number in EVERY:
        old, new = BY_NAME[name], variant(name, number, BY_NAME)
        assert type(new.course) is type(old.course)
        for each in fields(old.course):
            mine, other = getattr(new.course, each.name), getattr(old.course, each.name)
            if each.name in {"material", "top", "props", "body", "treads"}:
                known = {
                    getattr(e.course, each.name)
                    for e in ENTRIES
                    if isinstance(e.course, type(old.course))
                }
                assert mine in known
            else:
                assert mine == other


def test_variants_of_training_scenes_show_no_place_of_an_evaluation_scene():
    for name, number in EVERY:
        new = variant(name, number, BY_NAME)
        shown = [e for e in ENTRIES if e.setting is new.setting]
        assert {split_of(e.name) for e in shown} == {split_of(name)}
        assert {e.task for e in shown} == {new.task}
        assert name not in {e.name for e in shown}
        assert split_of(new.name) == split_of(name)


def test_a_variant_opens_by_its_name_on_the_very_trail_of_its_scene():
    scene, other = get_scene("gaps/three_15in_office"), get_scene("gaps/three_15in_office~2")
    np.testing.assert_array_equal(scene.trail, other.trail)
    assert scene.ground == other.ground
    # The boxes that bear the robot are those of the scene; what stands round is another place's.
    bearing = {box for box in scene.solids if abs(box.center[1]) < 0.5 and box.center[2] < 0}
    assert bearing
    assert {box.center for box in bearing} <= {box.center for box in other.solids}
    assert scene.digest != other.digest
    assert get_scene("gaps/three_15in_office~2").digest == other.digest


def test_patterns_name_variants_of_all_that_they_match():
    found = [reference for reference, _ in references(["split:eval~3", "ramps/two_*~1"])]
    assert found[:20] == [f"{name}~3" for name in names("eval")]
    assert found[20:] == [f"{name}~1" for name in names() if name.startswith("ramps/two_")]
    assert [r for r, _ in references(["split:train~2"])] == [f"{n}~2" for n in names("train")]


@pytest.mark.parametrize(
    "wrong", ["gaps/three_15in_office~0", "gaps/three_15in_office~100", "flat/carpet_room~1"]
)
def test_what_has_no_such_variant_is_no_scene(wrong):
    assert (parted(wrong) == (wrong, None)) != wrong.startswith("flat/")
    with pytest.raises(SceneError, match="no scene matches"):
        references([wrong])
