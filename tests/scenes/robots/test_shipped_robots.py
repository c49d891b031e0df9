"""Go1 and Go2 are what they were when they were written in Python, to the last bit.

`shipped_specs.json` holds every field of their specifications at 0fb181e, floats as hexadecimal
digits: another program wrote it, before their folders were there.
"""

import dataclasses
import json
import math
import shutil
from pathlib import Path

import pytest

from nw_scenes import robots
from nw_scenes.robots import BUILT_IN, find_robot, get_robot

BEFORE = json.loads(Path(__file__).with_name("shipped_specs.json").read_text(encoding="utf-8"))


def changes(value, before, where=""):
    """Yield what of a specification is not as it was; fields that came later are passed over."""
    if dataclasses.is_dataclass(value):
        for field in before:
            yield from changes(getattr(value, field), before[field], f"{where}.{field}")
    elif isinstance(value, dict) and list(value) == list(before):
        for key in value:
            yield from changes(value[key], before[key], f"{where}[{key}]")
    elif isinstance(value, tuple) and len(value) == len(before):
        for index, (now, was) in enumerate(zip(value, before, strict=True)):
            yield from changes(now, was, f"{where}[{index}]")
    elif (value.hex() if isinstance(value, float) else value) != before:
        yield where, value, before


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_field_of_a_shipped_robot_is_bit_for_bit_what_it_was(name):
    assert list(changes(get_robot(name), BEFORE[name])) == []


def test_a_changed_bit_and_a_camera_more_are_found():
    robot = get_robot("go1")
    other = math.nextafter(robot.spawn_height, 1.0)
    more = robot.cameras | {"more": robot.cameras["ego"]}
    changed = dataclasses.replace(robot, spawn_height=other, cameras=more)
    assert [where for where, _, _ in changes(changed, BEFORE["go1"])] == [
        ".cameras",
        ".spawn_height",
    ]


@pytest.mark.parametrize("name", BUILT_IN)
def test_rows_and_jobs_name_a_shipped_robot_by_its_name_alone(name):
    assert find_robot(name).reference == name


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_copy_of_a_shipped_folder_is_the_same_robot_under_its_own_name(name, tmp_path):
    folder = shutil.copytree(Path(robots.__file__).parent / name, tmp_path / "mine")
    file = folder / "robot.yaml"
    file.write_text(file.read_text().replace(f"name: {name}\n", "name: mine\n"))
    mine = find_robot(f"{folder}/").spec
    assert dataclasses.replace(mine, name=name) == get_robot(name)


def test_the_folder_of_a_shipped_robot_names_the_robot_itself():
    folder = Path(robots.__file__).parent / "go1"
    assert find_robot(f"{folder}/") == find_robot("go1")
