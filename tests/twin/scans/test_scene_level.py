"""`scenes level`: floor, flip and unit of a scene's mesh, with all that lies on it."""

import numpy as np
import pytest
import trimesh
from trimesh.transformations import rotation_matrix
from twin_parts import blobs

from nw_base.errors import SceneError, UsageError
from nw_scenes.capture_file import write_captures
from nw_scenes.folder import load_folder
from nw_sim.catalogue import inspect_scene
from nw_splat.files import read_splat, write_splat
from nw_twin.place import moved_points
from nw_twin.scans.levelling import level_scene

TILT = rotation_matrix(0.35, [1.0, 0.4, 0.1])


def block():
    """A floor of 5 x 3 m with a block of 10 cm on it; points, and faces that look outwards."""
    floor = trimesh.creation.box((5.0, 3.0, 0.2))
    floor.apply_translation((1.5, 0.0, -0.1))
    step = trimesh.creation.box((1.0, 1.0, 0.1))
    step.apply_translation((1.5, 0.0, 0.05))
    return trimesh.util.concatenate([floor, step])


@pytest.fixture
def tilted(tmp_path):
    """A scene folder with mesh, splat, camera and trail turned off the level, and its truth."""
    folder = tmp_path / "mine"
    folder.mkdir()
    mesh = block()
    mesh.apply_transform(TILT)
    mesh.export(folder / "collision.ply")
    points = np.random.default_rng(0).uniform((-0.9, -1.4, 0), (3.9, 1.4, 0.1), (400, 3))
    turned = moved_points(TILT, points)
    write_splat(folder / "splat.ply", blobs(turned))
    trail = moved_points(TILT, np.array([[1.5, 0.0, 0.1], [3.0, 0.0, 0.0]]))
    eye = moved_points(TILT, np.array([[0.0, 0.0, 1.5]]))[0]
    write_captures(folder / "captures.json", [(eye.tolist(), [1.0, 0.0, 0.0, 0.0])])
    rows = "".join(f"  - [{x:.5f}, {y:.5f}, {z:.5f}]\n" for x, y, z in trail)
    (folder / "scene.yaml").write_text(
        "nw-scene: 1\nname: mine\ntask: open  # by hand\nlicence: MIT\ncollision: collision.ply\n"
        f"splat: splat.ply\ncaptures: captures.json\ntrail:\n{rows}"
    )
    return folder, points


FLOOR = moved_points(TILT, np.array([[-0.9, -1.0, 0], [3.5, -1.0, 0], [0.0, 1.3, 0]]))


def words(points):
    return [",".join(f"{part:.5f}" for part in point) for point in points]


def test_three_points_of_the_floor_level_all_of_a_scene(tilted, ended):
    folder, points = tilted
    before = load_folder(folder).digest
    code, printed = ended("scenes", "level", folder, "--floor", *words(FLOOR))
    said = printed.out
    assert code == 2, "the splat of this scene is too thin to be ready"
    assert "not ready: the splat covers" in said
    scene = load_folder(folder)
    assert f"digest {before[:16]} -> {scene.digest[:16]}" in said
    assert "turned by 19.97 degrees; up is the side where +z was" in said
    vertices = scene.static_mesh.vertices
    heights = np.unique(np.round(vertices[:, 2], 3))
    assert heights.tolist() == [-0.2, 0.0, 0.1]
    at = moved_points(scene.T_world_splat, read_splat(scene.splat.path).means)
    assert np.abs(at[:, 2] - points[:, 2]).max() < 1e-4
    assert np.abs(scene.trail[:, 2] - (0.1, 0.0)).max() < 1e-3
    assert scene.captures.positions[0, 2] == pytest.approx(1.5, abs=1e-3)
    # One transform: distances between all of them stay.
    assert np.linalg.norm(scene.trail[1] - scene.captures.positions[0]) == pytest.approx(
        np.linalg.norm((3.0, 0.0, -1.5)), abs=1e-3
    )
    assert "task: open  # by hand" in (folder / "scene.yaml").read_text()
    faults = [one for one in inspect_scene(str(folder)).findings if one.severity == "error"]
    assert [one.code for one in faults] == ["splat_thin"]  # Of its 400 Gaussians.


def test_a_copy_leaves_the_scene_as_it_is_and_takes_a_trail_of_its_own(tilted, tmp_path):
    folder, _ = tilted
    before = (folder / "scene.yaml").read_bytes()
    written = level_scene(
        folder,
        floor=[tuple(point) for point in FLOOR],
        trail=[(0.0, 0.0), (1.5, 0.0), (3.0, 0.0)],
        out=tmp_path / "copy",
    )
    assert (folder / "scene.yaml").read_bytes() == before
    scene = load_folder(tmp_path / "copy")
    assert scene.digest == written.digest != written.before
    assert scene.spawn.position == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert scene.trail[:, 2] == pytest.approx([0.1, 0.0], abs=1e-3)
    assert (tmp_path / "copy" / "suite.yaml").exists()


def test_of_a_floor_on_its_side_up_is_where_the_mesh_rises_unless_it_is_flipped(tmp_path):
    floor = trimesh.creation.box((5.0, 3.0, 0.01))
    wall = trimesh.creation.box((5.0, 0.1, 2.0))
    wall.apply_translation((0.0, 1.45, 1.0))
    mesh = trimesh.util.concatenate([floor, wall])
    mesh.apply_transform(rotation_matrix(np.pi / 2, [1, 0, 0]))  # What was up is -y.
    mesh.export(tmp_path / "collision.ply")
    (tmp_path / "scene.yaml").write_text(
        "nw-scene: 1\nname: side\ntask: open\nlicence: MIT\ncollision: collision.ply\n"
        "trail: [[1.5, 0, 0]]\n"
    )
    points = [(-2.0, 0.0, -1.2), (2.0, 0.0, -1.2), (0.0, 0.0, 1.2)]
    for folder, flip, heights in (("up", False, (0.0, 2.0)), ("down", True, (-2.0, 0.0))):
        out = tmp_path / folder
        level_scene(tmp_path, floor=points, flip=flip, propose=True, out=out)
        z = load_folder(out).static_mesh.vertices[:, 2]
        assert (z.min(), z.max()) == pytest.approx(heights, abs=0.011)


def test_a_mesh_in_millimetres_with_a_trail_in_metres_is_mended_by_its_unit(tmp_path):
    mesh = block()
    mesh.apply_scale(1000.0)
    mesh.export(tmp_path / "collision.ply")
    (tmp_path / "scene.yaml").write_text(
        "nw-scene: 1\nname: mm\ntask: open\nlicence: MIT\ncollision: collision.ply\n"
        "trail: [[1.5, 0, 0.1], [3.0, 0, 0]]\n"
    )
    with pytest.raises(SceneError, match="its unit is not the metre"):
        load_folder(tmp_path)
    written = level_scene(tmp_path, unit="mm")
    assert written.before is None
    assert "the waypoints were in metres already" in "\n".join(written.lines)
    scene = load_folder(tmp_path)
    assert np.ptp(scene.static_mesh.vertices, axis=0) == pytest.approx((5.0, 3.0, 0.3))
    assert scene.trail.tolist() == [[1.5, 0, 0.1], [3.0, 0, 0]]


def test_what_is_no_floor_is_refused_and_changes_nothing(tilted, tmp_path):
    folder, _ = tilted
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    line = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)]
    for more, why in (
        ({}, "nothing to do"),
        ({"floor": line}, "on one line"),
        ({"floor": line[:2]}, "a floor of 2 points"),
        ({"floor": [(0.0, 0.0, 0.0), (90.0, 0.0, 0.0), (0.0, 90.0, 0.0)]}, "outside of the mesh"),
        ({"trail": [(0.0, 0.0), (1.0, 0.0)], "propose": True}, "--trail and --propose exclude"),
        ({"flip": True, "out": folder}, "is there already"),
    ):
        with pytest.raises(UsageError, match=why):
            level_scene(folder, **more)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    boxes = tmp_path / "boxes"
    boxes.mkdir()
    (boxes / "collision.yaml").write_text(
        "boxes:\n  - {center: [2.5, 0, 0.05], half_size: [0.5, 1.5, 0.05]}\n"
    )
    (boxes / "scene.yaml").write_text(
        "nw-scene: 1\nname: b\ntask: open\nlicence: MIT\ntrail: [[2.5, 0, 0.1]]\n"
    )
    with pytest.raises(SceneError, match="holds boxes"):
        level_scene(boxes, flip=True)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--floor", "0,0,0", "1,x,0", "-1,-2,0"), "--floor 1,x,0: no point X,Y,Z"),
        (("--trail", "0,0", "1e308,0"), "--trail 1e308,0: a number over 1e+07"),
    ],
)
def test_a_point_that_is_none_is_named_with_its_option(tilted, ended, words, said):
    code, printed = ended("scenes", "level", tilted[0], *words)
    assert code == 2
    assert said in printed.err


def test_a_fault_of_a_scene_that_is_copied_names_its_own_file(tilted, tmp_path):
    folder, _ = tilted
    (folder / "collision.ply").write_bytes(b"ply\nno")
    with pytest.raises(SceneError, match=f"^{folder}/collision.ply: ") as error:
        level_scene(folder, flip=True, out=tmp_path / "copy")
    assert ".new-" not in str(error.value)
    assert not (tmp_path / "copy").exists()
