"""Variants of published folders, and everything that can be wrong with one."""

import json
import math

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_scenes.neverwhere import inspect_published, load_published
from nw_scenes.neverwhere.files import PUBLISHED
from nw_scenes.rays import RayScene
from nw_scenes.scene import HeightField, Triangles
from nw_splat.files import read_splat, write_splat
from nw_splat.store import open_store


def codes(folder, severity="error"):
    return [f.code for f in inspect_published(folder).findings if f.severity == severity]


def blob(count=500):
    """Return Gaussians spread over the scene of the writer."""
    random = np.random.default_rng(0)
    return {
        "means": random.uniform((-2, -2, 0), (6, 2, 0.5), (count, 3)),
        "log_scales": np.full((count, 3), -3.0),
        "quats": random.normal(size=(count, 4)),
        "opacity_logits": np.full(count, 2.0),
        "sh": random.normal(size=(count, 1, 3)),
    }


# What is read.


def test_task_and_noise_come_from_the_published_table(writer):
    scene = load_published(writer.write())
    assert (scene.name, scene.task) == ("neverwhere/hurdle_stata_v1", "hurdles")
    assert scene.waypoint_noise == (0.0, 0.35)


def test_the_table_has_the_published_counts():
    tasks = [row.task for row in PUBLISHED.values()]
    extra = [name for name in PUBLISHED if name.startswith("lucidsim_")]
    assert len(PUBLISHED) == 67
    assert len(extra) == 4
    counts = {t: tasks.count(t) for t in ("gaps", "hurdles", "stairs", "ramps")}
    # 12, 17, 17, 17 benchmark scenes, and two extra ones each of hurdles and stairs.
    assert counts == {"gaps": 12, "hurdles": 19, "stairs": 19, "ramps": 17}


def test_waypoints_are_sorted_as_strings(writer):
    writer.trail = np.array([[0.3 * i, 0.01 * i, 0.2] for i in range(12)])
    scene = load_published(writer.write())
    order = [0, 1, 10, 11, 2, 3, 4, 5, 6, 7, 8, 9]
    assert scene.trail == pytest.approx(writer.trail[order])


def test_the_yaw_of_a_waypoint_means_nothing(writer):
    writer.yaw = 1.1
    assert load_published(writer.write()).trail == pytest.approx(writer.trail)


def test_go2_reads_the_same_place(writer):
    folder = writer.write()
    assert load_published(folder, robot="go2").digest == load_published(folder).digest


def test_the_other_robots_xml_serves_where_there_is_only_one(writer):
    writer.robots = ("go2",)
    assert load_published(writer.write(), robot="go1").trail.shape == (2, 3)


def test_a_folder_of_another_name_has_the_name_of_the_xml_of_any_robot(writer):
    writer.robots = ("go1",)
    folder = writer.write()
    (xml,) = folder.glob("nw-*.xml")
    xml.rename(folder / f"nw-a-long-name-{folder.name}.xml")
    moved = folder.rename(folder.with_name("moved"))
    scene = load_published(moved, robot="a-long-name")
    assert scene.name == "neverwhere/hurdle_stata_v1"


def test_an_offset_collision_body_moves_what_is_touched_and_not_what_is_seen(writer):
    """As in the three gaps scenes, whose collision body has a position of its own."""
    writer.offset, writer.turn = (-1.4, 0.0, -0.4), (0.1, -0.2, 0.4)
    folder = writer.write()
    scene = load_published(folder)
    assert scene.solids[0].height(np.array([[1.0, 0.0]])) == pytest.approx([0.0], abs=1e-5)
    assert RayScene(scene.mesh()).height(np.array([[1.0, 0.0]])) == pytest.approx([0.0], abs=1e-6)
    assert "inconsistent_meshes" not in codes(folder)


def test_the_xml_may_lie_beside_real_scenes_as_in_the_code_repository(writer, tmp_path):
    folder = writer.write()
    xml = folder / "nw-go1-hurdle_stata_v1.xml"
    outside = tmp_path / xml.name
    digest = load_published(folder).digest
    xml.rename(outside)
    (folder / "nw-go2-hurdle_stata_v1.xml").unlink()
    assert load_published(folder).digest == digest
    assert load_published(outside).digest == digest


def test_a_linked_scene_folder_is_read(writer, tmp_path):
    folder = writer.write()
    elsewhere = tmp_path / "disk" / folder.name
    elsewhere.parent.mkdir()
    folder.rename(elsewhere)
    folder.symlink_to(elsewhere)
    assert load_published(folder).name == "neverwhere/hurdle_stata_v1"


def test_robot_files_are_read_for_their_angles_only(writer):
    """A robot's own file that is there sets the unit of angles, and adds no geometry."""
    folder = writer.write()
    digest = load_published(folder).digest
    robot = folder / "go1" / "gabe_go1.xml"
    robot.parent.mkdir()
    robot.write_text(
        '<mujoco><compiler angle="radian" meshdir="meshes"/><worldbody><body name="trunk">'
        '<freejoint/><geom size="1"/></body></worldbody></mujoco>'
    )
    assert load_published(folder).digest == digest


def test_friction_of_the_collision_geom_is_kept(writer):
    writer.friction = "0.7 0.2 0.1"
    scene = load_published(writer.write())
    assert scene.solids[0].friction == (0.7, 0.2, 0.1)


def test_triangles_are_those_of_the_collision_mesh_itself(writer):
    scene = load_published(writer.write(), collision="triangles")
    assert isinstance(scene.solids[0], Triangles)


def test_the_catching_plane_is_below_the_scan(writer):
    scene = load_published(writer.write())
    assert isinstance(scene.solids[0], HeightField)
    assert scene.ground.z == pytest.approx(-0.5)


def test_spawn_stays_at_zero_as_published_unless_the_floor_is_far_from_it(writer):
    assert load_published(writer.write()).spawn.position == (0.0, 0.0, 0.0)
    writer.vertices = writer.vertices - np.array([0, 0, 0.3])
    writer.trail = writer.trail - np.array([0, 0, 0.3])
    scene = load_published(writer.write())
    assert scene.spawn.position[2] == pytest.approx(-0.3, abs=1e-5)
    assert "floor_offset" in codes(writer.folder, "warning")


def test_the_digest_follows_what_matters(writer):
    first = load_published(writer.write()).digest
    writer.trail = writer.trail + np.array([0, 0.1, 0])
    assert load_published(writer.write()).digest != first


# What is wrong.


def test_a_scene_in_order_has_no_errors(writer):
    writer.splat = blob()
    assert codes(writer.write()) == []


def test_a_mesh_of_another_label_is_found_with_numbers(writer):
    """`hurdle_black_stone_v1` was labelled anew: its scale went from 0.871 to 0.431."""
    folder = writer.write()
    writer.label.scale *= 0.431 / 0.871
    writer.write_xml()
    (finding,) = [f for f in inspect_published(folder).findings if f.code == "inconsistent_meshes"]
    assert finding.severity == "error"
    assert finding.value > 0.05


def test_a_centimetre_of_disagreement_is_measured_as_such(writer):
    writer.offset = (0.0, 0.0, 0.03)
    folder = writer.write()
    for robot in ("go1", "go2"):
        xml = folder / f"nw-{robot}-{folder.name}.xml"
        xml.write_text(xml.read_text().replace('pos="0.0 0.0 0.03"', 'pos="0 0 0"'))
    (finding,) = [f for f in inspect_published(folder).findings if f.code == "inconsistent_meshes"]
    assert finding.value == pytest.approx(0.03, abs=1e-4)


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        ("1 1 1.1", "not uniform"),
        ("-1 1 1", "mirrors"),
        ("0 0 0", "flattens"),
        ("1 1", "has 2 numbers"),
        ("nan nan nan", "not finite"),
        ("one 1 1", "not a list of numbers"),
    ],
)
def test_scales_that_no_splat_follows_are_refused(writer, scale, words):
    writer.scale = scale
    folder = writer.write()
    with pytest.raises(SceneError, match=words) as error:
        load_published(folder)
    assert "nw-go1-hurdle_stata_v1.xml:" in str(error.value)
    assert codes(folder) == ["unreadable"]


@pytest.mark.parametrize(
    ("attribute", "words"),
    [
        ("/etc/passwd", "absolute"),
        ("C:/meshes/a.obj", "absolute"),
        ("file:///etc/passwd", "absolute"),
        ("\\\\host\\share\\a.obj", "absolute"),
        ("../../secret.obj", "'..'"),
        ("real_scenes/hurdle_stata_v1/../../../secret.obj", "'..'"),
        ("geometry\\..\\..\\secret.obj", "'..'"),
        ("real_scenes/hurdle_stata_v1/geometry/none.obj", "no file"),
    ],
)
def test_paths_out_of_the_scene_are_refused(writer, tmp_path, attribute, words):
    (tmp_path / "secret.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    folder = writer.write()
    xml = folder / "nw-go1-hurdle_stata_v1.xml"
    good = "real_scenes/hurdle_stata_v1/geometry/collision_mesh.obj"
    xml.write_text(xml.read_text().replace(good, attribute))
    with pytest.raises(SceneError, match=words):
        load_published(folder)


def test_a_link_out_of_the_scene_is_refused(writer, tmp_path):
    folder = writer.write()
    mesh = folder / "geometry" / "collision_mesh.obj"
    outside = tmp_path / "outside" / "a.obj"
    outside.parent.mkdir()
    mesh.rename(outside)
    mesh.symlink_to(outside)
    with pytest.raises(SceneError, match="link out of the scene"):
        load_published(folder)


@pytest.mark.parametrize(
    "file", ["geometry/visual_mesh_simplified.obj", "geometry/collision_mesh.obj"]
)
def test_missing_meshes_are_named(writer, file):
    folder = writer.write()
    (folder / file).unlink()
    with pytest.raises(SceneError, match=file.split("/")[1]):
        load_published(folder)


def test_a_missing_splat_is_an_error_of_the_check_and_none_of_blind_policies(writer):
    folder = writer.write()
    assert codes(folder) == ["no_splat"]
    with pytest.raises(SceneError, match="no splat"):
        load_published(folder).splat_store()


def test_the_export_of_a_splat_is_read_where_there_is_no_checkpoint(writer):
    writer.splat = blob()
    folder = writer.write()
    checkpoint = load_published(folder)
    write_splat(folder / "3dgs" / "model.ply", read_splat(folder / "3dgs" / "model.pt"))
    assert load_published(folder).digest == checkpoint.digest
    (note,) = inspect_published(folder).findings
    assert (note.code, note.severity) == ("two_splats", "note")
    assert note.message.endswith("3dgs holds model.pt and model.ply: model.pt is read")
    (folder / "3dgs" / "model.pt").unlink()
    assert codes(folder) == []
    exported = load_published(folder)
    assert exported.splat.path.name == "model.ply"
    for ours, theirs in zip(
        open_store(exported.splat_store()).layout.arrays().values(),
        open_store(checkpoint.splat.store()).layout.arrays().values(),
        strict=True,
    ):
        assert np.array_equal(ours, theirs)


def test_an_empty_splat_is_named(writer):
    writer.splat = {k: v[:0] for k, v in blob().items()}
    assert codes(writer.write()) == ["splat_empty"]


def test_a_file_that_is_no_splat_is_named(writer):
    writer.splat = blob()
    folder = writer.write()
    (folder / "3dgs" / "model.pt").write_bytes(b"not a checkpoint at all")
    assert codes(folder) == ["splat_invalid"]


def test_a_splat_in_another_frame_is_found(writer):
    writer.splat = blob()
    folder = writer.write()
    (folder / "3dgs" / "data_transforms.json").unlink()
    assert codes(folder) == ["splat_elsewhere"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{}", "transform"),
        ("[1, 2]", "transform"),
        ("not json", "transform"),
        ('{"transform": [[1, 0], [0, 1]]}', "shape"),
        (json.dumps({"transform": np.diag([1.0, 1, 2, 1])[:3].tolist()}), "stretches"),
        (json.dumps({"transform": np.diag([1.0, 1, -1, 1])[:3].tolist()}), "mirrors"),
        (json.dumps({"transform": np.diag([0.0, 0, 0, 1])[:3].tolist()}), "flattens"),
        ('{"transform": [[NaN,0,0,0],[0,1,0,0],[0,0,1,0]]}', "shape|finite"),
    ],
)
def test_normalisations_that_are_no_similarity_are_refused(writer, content, words):
    folder = writer.write()
    (folder / "3dgs").mkdir(exist_ok=True)
    (folder / "3dgs" / "data_transforms.json").write_text(content)
    with pytest.raises(SceneError, match=words):
        load_published(folder)


def test_nan_vertices_are_named(writer):
    writer.vertices = writer.vertices.copy()
    writer.vertices[3] = math.nan
    with pytest.raises(SceneError, match="not finite"):
        load_published(writer.write())


def test_a_mesh_turned_inside_out_is_found(writer):
    writer.faces = writer.faces[:, ::-1]
    assert "inside_out" in codes(writer.write())


def test_waypoints_off_the_mesh_and_under_it_are_found(writer):
    writer.trail = np.array([[1.7, 0.0, 0.15], [1.7, 0.1, -0.1], [2.5, 30.0, 0.0]])
    found = [f for f in inspect_published(writer.write()).findings if f.severity == "error"]
    assert {f.code for f in found} >= {"waypoint_below_surface", "waypoint_off_mesh"}
    (below,) = [f for f in found if f.code == "waypoint_below_surface"]
    assert "waypoint 1" in below.message
    assert below.value == pytest.approx(0.25, abs=1e-3)


def test_a_spawn_inside_geometry_is_found(writer):
    writer.vertices = writer.vertices - np.array([1.7, 0.0, 0.0])
    writer.vertices[625:, 2] *= 3.0
    writer.trail = np.array([[2.0, 0.0, 0.0]])
    assert "spawn_blocked" in codes(writer.write())


def test_a_spawn_without_floor_is_found(writer):
    writer.vertices = writer.vertices + np.array([4.0, 0.0, 0.0])
    writer.trail = writer.trail + np.array([4.0, 0.0, 0.0])
    assert "no_floor_under_spawn" in codes(writer.write())


def test_xmls_of_the_two_robots_that_differ_are_said(writer):
    folder = writer.write()
    writer.trail = writer.trail + np.array([0.0, 0.2, 0.0])
    writer.write_xml("go2")
    assert "xml_disagree" in codes(folder, "warning")


def test_a_scene_without_waypoints_is_refused(writer):
    writer.trail = np.zeros((0, 3))
    folder = writer.folder
    folder.mkdir(parents=True)
    writer.write_xml()
    with pytest.raises(SceneError, match="waypoint"):
        load_published(folder)


def test_folders_without_an_xml_are_named(tmp_path):
    with pytest.raises(SceneError, match="no such folder"):
        load_published(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(SceneError, match="0 XML files"):
        load_published(tmp_path / "empty")
