"""What a scan's numbers leave open is said: up, unit, the ground of a course; and it is checked."""

import re

import numpy as np
import pytest
import trimesh
from twin_parts import grid, joined

from nw_scenes.check import room_of
from nw_scenes.folder import load_folder
from nw_scenes.mesh_file import read_mesh
from nw_sim.catalogue import inspect_scene
from nw_twin.scans.scan import ScanOptions, import_scan
from nw_twin.verbs.scenes import scan_lines

Y_UP = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])


def sheet(corner, one, other, *, cells=8):
    """A rectangle that looks along one x other."""
    return grid(corner, one, other, (cells, cells))


X, Y, Z = np.eye(3)


def room(*, roof=False):
    """A shell seen from inside, z up, m: the floor is 4.4 x 3.6, furniture hides the rest of it."""
    parts = [
        sheet((-2.2, -1.8, 0), 4.4 * X, 3.6 * Y, cells=24),
        sheet((-3, -3, 2.6), 6 * Y, 6 * X),
        sheet((-3, -3, 0), 6 * Y, 2.6 * Z),
        sheet((3, -3, 0), 2.6 * Z, 6 * Y),
        sheet((-3, -3, 0), 2.6 * Z, 6 * X),
        sheet((-3, 3, 0), 6 * X, 2.6 * Z),
        sheet((-3, 1.8, 0.8), 6 * X, 1.2 * Y),
        sheet((-3, 1.8, 0), 6 * X, 0.8 * Z),
        sheet((-3, -3, 0.45), 6 * X, 1.2 * Y),
        sheet((-3, -1.8, 0), 0.45 * Z, 6 * X),
    ]
    if roof:
        parts.append(sheet((-3.2, -3.2, 2.8), 6.4 * X, 6.4 * Y))
    return joined(*parts)


def write(path, points, faces, turn=None):
    points = points if turn is None else points @ turn.T
    trimesh.Trimesh(points, faces, process=False).export(path)
    return path


def errors_of(folder):
    return [f.code for f in inspect_scene(str(folder)).findings if f.severity == "error"]


@pytest.mark.parametrize(
    ("name", "turn", "up", "roof"),
    [
        ("a.glb", Y_UP, "+y", True),
        ("a.obj", np.eye(3), "+z", False),
        ("a.obj", Y_UP, "+y", False),
        ("a.stl", UPSIDE_DOWN @ Y_UP, "-y", False),
    ],
)
def test_a_room_stands_on_its_floor_and_the_course_lies_there(tmp_path, name, turn, up, roof):
    write(tmp_path / name, *room(roof=roof), turn)
    written = import_scan(tmp_path / name, tmp_path / "mine")
    assert f"up is {up} of the file" in "\n".join(written.lines)
    if up == "-y":  # No format has it so: what stands in the room says it to 89 %, and it is asked.
        assert f"degrees of {up} 89%" in written.fault
    else:
        assert written.fault is None
    scene = load_folder(tmp_path / "mine")
    # z = 0 is the floor: tables are above it, and the ceiling 2.6 m; a roof is 0.2 m higher.
    low, high = scene.static_mesh.vertices.min(axis=0), scene.static_mesh.vertices.max(axis=0)
    assert (low[2], high[2]) == pytest.approx((0.0, 2.8 if roof else 2.6), abs=1e-3)
    assert np.abs(scene.trail[:, 2]).max() < 1e-3


def test_a_glb_that_is_upside_down_is_not_ready_until_its_up_axis_is_given(tmp_path):
    write(tmp_path / "a.glb", *room(), UPSIDE_DOWN @ Y_UP)
    written = import_scan(tmp_path / "a.glb", tmp_path / "mine")
    assert re.search(r"known to 180 degrees only: within 20 degrees of \+y \d+%, -y", written.fault)
    written = import_scan(tmp_path / "a.glb", tmp_path / "told", ScanOptions(up="-y"))
    assert written.fault is None
    assert errors_of(tmp_path / "told") == []


def test_a_robot_under_the_floor_and_a_room_on_its_ceiling_are_findings(tmp_path):
    points, faces = room()
    write(tmp_path / "over.glb", points, faces, UPSIDE_DOWN @ Y_UP)
    options = ScanOptions(up="+y")
    import_scan(tmp_path / "over.glb", tmp_path / "over", options)
    codes = [finding.code for finding in inspect_scene(str(tmp_path / "over")).findings]
    assert "upside_down" in codes
    # Two floors without undersides: the robot is put under the upper one.
    two = joined(
        sheet((-2, -2, 0), 6 * X, 4 * Y, cells=24), sheet((-2, -2, 1.5), 6 * X, 4 * Y, cells=24)
    )
    write(tmp_path / "two.ply", *two)
    options = ScanOptions(trail=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)))
    written = import_scan(tmp_path / "two.ply", tmp_path / "two", options)
    assert "under_floor" in errors_of(tmp_path / "two")
    assert "the robot's eye is under a floor" in written.fault


def test_what_stands_where_the_robot_starts_keeps_an_import_from_being_ready(tmp_path, ended):
    ground = sheet((-2, -2, 0), 8 * X, 4 * Y, cells=40)
    block = trimesh.creation.box((0.2, 0.6, 1.2))
    block.apply_translation((0.21, 0, 0.59))  # No corner of it is one of the ground, too.
    points, faces = joined(ground, (np.array(block.vertices), np.array(block.faces)))
    write(tmp_path / "a.ply", points, faces)
    words = ("--out", tmp_path / "mine", "--trail", "0,0,0", "2,0,0", "4,0,0")
    code, printed = ended("scenes", "import", tmp_path / "a.ply", *words)
    assert code == 2
    assert printed.out.splitlines()[-1].startswith("not ready: a solid is where the robot starts")
    assert "check: error spawn_blocked" in printed.out
    # The one that is proposed goes round it.
    written = import_scan(tmp_path / "a.ply", tmp_path / "other")
    assert written.fault is None
    assert scan_lines(written).splitlines()[-1].startswith("ready: ")


def test_a_proposed_course_says_what_its_ground_is_like(tmp_path):
    points, faces = sheet((0, -2, 0), 6 * X, 4 * Y, cells=60)
    points[:, 2] = 0.1 * np.sin(2 * points[:, 0]) + np.where(points[:, 0] > 3, 0.2, 0)
    points[:, 2] += 0.1 * np.cos(3 * points[:, 1])
    write(tmp_path / "bumpy.ply", points, faces)
    written = import_scan(tmp_path / "bumpy.ply", tmp_path / "mine")
    said = "\n".join(written.lines)
    assert "straight over uneven ground" in said
    (words,) = [line for line in written.lines if line.startswith("course proposed")]
    scene = load_folder(tmp_path / "mine")
    way = np.vstack([scene.spawn.position, scene.trail])
    rise = float(words.split("rises by ")[1].split(" m")[0])
    assert rise >= np.diff(way[:, 2]).clip(0).sum() - 0.02
    assert rise + float(words.split("falls by ")[1].split(" m")[0]) > 0.05
    for measured in ("check: roughness:", "check: steps:", "check: for the legs of go1: steps of"):
        assert measured in said
    points[:, 2] = 0
    write(tmp_path / "even.ply", points, faces)
    written = import_scan(tmp_path / "even.ply", tmp_path / "flat")
    assert "straight over even ground" in "\n".join(written.lines)
    assert "rises by 0.00 m and falls by 0.00 m in all" in "\n".join(written.lines)


def test_of_equally_long_courses_the_most_even_is_proposed(tmp_path):
    points, faces = sheet((-3, -3, 0), 6 * X, 6 * Y, cells=60)
    points[:, 2] = np.where(points[:, 1] > 0, 0.12 * np.sin(3 * points[:, 0]), 0.0)
    write(tmp_path / "a.ply", points, faces)
    written = import_scan(tmp_path / "a.ply", tmp_path / "mine")
    assert "straight over even ground" in "\n".join(written.lines)
    scene = load_folder(tmp_path / "mine")
    assert np.ptp([scene.spawn.position[2], *scene.trail[:, 2]]) < 0.05


def test_the_unit_of_a_file_and_the_height_of_its_rooms_are_compared_with_the_options(tmp_path):
    points, faces = room()
    write(tmp_path / "a.obj", 1000 * points, faces)
    text = (tmp_path / "a.obj").read_text()
    (tmp_path / "a.obj").write_text("# units: mm\n" + text)
    written = import_scan(tmp_path / "a.obj", tmp_path / "mm")
    assert "one unit is 0.001 m" in "\n".join(written.lines)
    assert load_folder(tmp_path / "mm").static_mesh.vertices[:, 2].max() == pytest.approx(2.6)
    write(tmp_path / "b.obj", points, faces)
    feet = import_scan(tmp_path / "b.obj", tmp_path / "in", ScanOptions(unit="ft"))
    assert "a ceiling is 0.7" in "\n".join(feet.lines)
    (tmp_path / "b.obj").write_text("# units: m\n" + (tmp_path / "b.obj").read_text())
    told = import_scan(tmp_path / "b.obj", tmp_path / "told", ScanOptions(unit="ft"))
    assert "the file gives its unit as m, and it is read as ft" in "\n".join(told.lines)


def test_a_room_is_known_by_its_ceiling_and_what_stands_in_it(tmp_path):
    mesh = read_mesh(write(tmp_path / "a.ply", *room()))
    up = room_of(mesh.triangles, Z)
    assert up.height == pytest.approx(2.6, abs=0.05)
    assert up.contents < 0.3
    down = room_of(mesh.triangles, -Z)
    assert down.contents > 0.7
    points, faces = sheet((0, 0, 0), X, Y)
    assert room_of(points[faces], Z) is None
