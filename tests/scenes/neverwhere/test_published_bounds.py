"""What a stranger's published scene may say: numbers of a place, and not too many of anything."""

from __future__ import annotations

import json

import pytest

from nw_base.errors import SceneError
from nw_scenes.neverwhere import load_published

BOX = '<geom type="box" size="1 1 1"/>'
WORLD = '<mujoco><worldbody>{}<body name="waypoint-0" pos="1 0 0"/></worldbody></mujoco>'


@pytest.mark.parametrize(
    ("world", "words"),
    [
        ('<geom type="box" size="1 1 1e300"/>', "nothing may be beyond 1e"),
        ('<geom type="box" size="1 1 5000"/>', "makes no box"),
        ('<geom type="sphere" size="1e-9"/>', "makes no sphere"),
        ('<geom type="box" size="1 1 1" friction="-1"/>', "friction='-1'; give numbers up to 5"),
        ('<geom type="box" size="1 1 1" friction="1 900"/>', "friction='1 900'"),
        ('<geom type="plane" size="0 0 1" friction="0"/>', "friction='0'"),
        ('<geom type="plane" size="0 0 1" pos="0 0 5e4"/>', "the ground lies at z = 50000"),
        ('<geom type="box" size="1 1 1" pos="0 0 5e4"/>', "it lies at"),
        ('<geom type="box" size="1 1 1" quat="1e-200 0 0 0"/>', "quat is zero"),
        (f'{BOX}<body name="waypoint-1" pos="2000 0 0"/>', "'waypoint-1' is at"),
        (f'{BOX}<body pos="9e5 0 0"><body name="waypoint-1" pos="9e5 0 0"/></body>', "is at"),
        (BOX + "".join(f'<body name="waypoint{i}"/>' for i in range(300)), "301 waypoints"),
        (2001 * BOX, "2001 solids"),
        ("<geom " + " ".join(f'a{i}=""' for i in range(100)) + "/>", "100 attributes"),
    ],
)
def test_numbers_of_no_place_are_refused(tmp_path, world, words):
    (tmp_path / "a.xml").write_text(WORLD.format(world))
    with pytest.raises(SceneError, match=words) as error:
        load_published(tmp_path / "a.xml")
    assert "a.xml" in str(error.value)


def test_files_that_include_each_other_many_times_over_are_refused(tmp_path):
    """Ten levels of ten includes are ten thousand million files."""
    for level in range(10):
        below = 10 * f'<include file="{level + 1}.xml"/>'
        (tmp_path / f"{level}.xml").write_text(f"<mujoco>{below}</mujoco>")
    (tmp_path / "10.xml").write_text("<mujoco/>")
    with pytest.raises(SceneError, match="more than 200 files are included"):
        load_published(tmp_path / "0.xml")


def test_a_thousand_default_classes_are_enough(tmp_path):
    classes = "".join(f'<default class="c{i}"/>' for i in range(1100))
    (tmp_path / "a.xml").write_text(f"<mujoco><default>{classes}</default></mujoco>")
    with pytest.raises(SceneError, match="more than 1000 default classes"):
        load_published(tmp_path / "a.xml")


@pytest.mark.parametrize("entry", ["1" + 400 * "0", "1e300", "[1]", '"1"'])
def test_a_normalisation_of_wild_numbers_is_refused(writer, entry):
    folder = writer.write()
    (folder / "3dgs").mkdir(exist_ok=True)
    rows = f"[[{entry},0,0,0],[0,1,0,0],[0,0,1,0]]"
    (folder / "3dgs" / "data_transforms.json").write_text(f'{{"transform": {rows}}}')
    if entry == '"1"':  # A number all the same.
        load_published(folder)
    else:
        with pytest.raises(SceneError, match=r"data_transforms\.json: .*transform"):
            load_published(folder)


def test_a_scale_of_no_place_is_refused(writer):
    writer.scale = "1e-9 1e-9 1e-9"
    with pytest.raises(SceneError, match="from 1e-06 to 1e"):
        load_published(writer.write())


@pytest.mark.parametrize("name", ["3dgs/model.pt", "3dgs/model.ply", "3dgs/data_transforms.json"])
def test_a_splat_that_is_a_link_out_of_the_scene_is_refused(writer, tmp_path, name):
    folder = writer.write()
    (tmp_path / "elsewhere").write_text(json.dumps({}))
    (folder / "3dgs").mkdir(exist_ok=True)
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(SceneError, match="a link on its way leads to"):
        load_published(folder)


def test_a_folder_with_a_strange_name_gives_a_name_that_folders_can_have(tmp_path):
    (tmp_path / "nw-go1-x.xml").write_text(WORLD.format(BOX))
    folder = tmp_path / "..a b\n::error::c"
    folder.mkdir()
    (tmp_path / "nw-go1-x.xml").rename(folder / f"{folder.name}.xml")
    assert load_published(folder).name == "neverwhere/a-b-error-c"
