"""What a robot of a folder looks like: its visual meshes, with fewer faces, where they are."""

import io
import os
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from nw_base.files.cache import sealed_path
from nw_eval import api
from nw_eval.engine.listener import NullListener
from nw_eval.view.drawing import triangles_of
from nw_eval.viewing.recording.content import archetypes
from nw_scenes.mesh import TriangleMesh, merge
from nw_scenes.rays import RayScene
from nw_scenes.robots import Triangles, find_robot, get_robot
from nw_scenes.robots.looks import MOST_FACES, kept_thinned, shares, thinned
from nw_scenes.scene import Scene
from nw_sim.physics import World
from nw_sim.rollout.mcap.drawn import robot_clouds, robot_update
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.replaying.third_person import Spectator

ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", Path(__file__).parents[4] / "shared" / "assets"))
FLAT = Scene(
    name="tests/flat",
    task="hurdles",
    title="",
    solids=(),
    trail=np.array([[1.0, 0.0, 0.0]]),
    static_mesh=merge([]),
    splat=None,
)
NOWHERE = np.zeros((0, 3))
MJCF = """
<mujoco>
  <default>
    <default class="seen">
      <geom contype="0" conaffinity="0" group="2" rgba="0.1 0.7 0.1 1"/>
    </default>
  </default>
  <asset>
    <material name="red" rgba="0.9 0.1 0.2 1"/>
    <mesh name="hull" file="hull.stl" scale="0.1 0.2 0.1" refpos="0.3 0 0"/>
    <mesh name="ball" file="ball.obj" scale="0.05 0.05 0.05"/>
  </asset>
  <worldbody>
    <body name="top" pos="0 0 0.4">
      <freejoint/>
      <geom type="box" size="0.25 0.15 0.03" mass="6"/>
      <geom type="mesh" mesh="hull" material="red" contype="0" conaffinity="0" mass="0"
            pos="0.05 0.02 0.1" quat="0.9 0.1 0.3 0.2"/>
      <geom type="mesh" mesh="ball" class="seen" material="red" mass="0" pos="-0.2 0 0.1"/>
      <geom type="mesh" mesh="ball" class="seen" rgba="0 0 1 0" mass="0" pos="0.2 0 0.1"/>
      LEGS
    </body>
  </worldbody>
</mujoco>
"""
LEG = """
<body name="leg_{0}" pos="{1} {2} 0"><joint name="hip_{0}" axis="0 1 0" range="-40 40"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5" rgba="0 1 1 1"/></body>"""
LEGS = "".join(
    LEG.format(name, x, y)
    for name, x, y in (
        ("fr", 0.2, -0.12),
        ("fl", 0.2, 0.12),
        ("rr", -0.2, -0.12),
        ("rl", -0.2, 0.12),
    )
)
YAML = """\
nw-robot: 1
name: table
model: {file: robot.xml}
motors:
  - {joints: "*", kp: 60, kd: 2, torque: 30, armature: 0.01}
"""


TABLE = MJCF.replace("LEGS", LEGS)


def written(folder, model=TABLE):
    """Write a robot that has meshes beside what collides."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.xml").write_text(model)
    (folder / "robot.yaml").write_text(YAML)
    trimesh.creation.cone(radius=1.0, height=2.0).export(folder / "hull.stl")
    trimesh.creation.icosphere(subdivisions=3).export(folder / "ball.obj")
    return folder


@pytest.fixture
def table(tmp_path):
    return find_robot(f"{written(tmp_path / 'table')}/").spec


def theirs(path, world):
    """Return MuJoCo's own model of a robot's file, in the pose of a world."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[3:7] = world.trunk_position, world.trunk_quat
    for name, angle in zip(world.robot.joints, world.joint_positions, strict=True):
        data.qpos[model.joint(name).qposadr] = angle
    mujoco.mj_forward(model, data)
    return model, data


def rays_at(middle, *, reach, count=40):
    """Return rays from five sides that cover a robot."""
    grid = np.linspace(-reach, reach, count)
    across = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    for side in (
        (2.0, 0.3, 0.5),
        (-2.0, 0.2, 0.2),
        (0.3, 2.0, 0.3),
        (0.2, -2.0, 0.8),
        (0.1, 0.2, 2.5),
    ):
        eye = np.array(side)
        u = np.cross(eye, [0.3, 0.5, 0.8])
        u /= np.linalg.norm(u)
        v = np.cross(eye, u) / np.linalg.norm(eye)
        ways = across[:, :1] * u + across[:, 1:] * v - eye
        yield middle + eye, ways / np.linalg.norm(ways, axis=1, keepdims=True)


def met(model, data, origin, directions, group):
    """Return how far MuJoCo's rays at a group of geoms go, inf where they meet nothing."""
    chosen = np.zeros(mujoco.mjNGROUP, np.uint8)
    chosen[group] = 1
    found = np.full(len(directions), np.inf)
    geom = np.zeros(1, np.int32)
    # One by one: its fan of rays passes over bodies without collisions.
    for number, way in enumerate(directions):
        distance = mujoco.mj_ray(model, data, origin, way, chosen, 0, -1, geom, None)
        found[number] = distance if geom[0] >= 0 else np.inf
    return found


def test_rays_meet_meshes_where_mujoco_has_them_and_through_what_collides(tmp_path, table):
    alone = MJCF.replace("LEGS", LEGS.replace('rgba="0 1 1 1"', 'group="2"'))
    alone = alone.replace('<geom type="box"', '<geom group="4" type="box"')
    alone = alone.replace('rgba="0 0 1 0"', 'group="4"').replace(
        'conaffinity="0" mass', 'conaffinity="0" group="2" mass'
    )
    written(tmp_path / "own", alone)
    with World(table, FLAT) as world:
        world.reset(position=(0.4, -0.2, 0.7), yaw=0.6, joint_positions=(0.3, -0.2, 0.1, 0.0))
        model, data = theirs(tmp_path / "own" / "robot.xml", world)
        for origin, directions in rays_at(world.trunk_position, reach=0.5):
            hits = world.ray_robot(origin, directions)
            expected = met(model, data, origin, directions, 2)
            both = np.isfinite(hits.distance) & np.isfinite(expected)
            assert both.sum() > 80
            # Legs are drawn with 32 sides; meshes are what they are.
            assert (np.isfinite(hits.distance) != np.isfinite(expected)).mean() < 0.01
            apart = np.abs(hits.distance[both] - expected[both])
            mesh = np.array([shape.kind == "mesh" for shape in table.visuals])[hits.geom[both]]
            assert np.median(apart[mesh]) < 1e-4
            assert np.percentile(apart, 98) < 0.004
            assert ((hits.normal[both] * directions[both]).sum(axis=1) <= 0.0).all()


def test_a_shape_has_the_colour_that_mujoco_draws_and_what_is_not_seen_is_not_drawn(table):
    colours = {shape.body: [] for shape in table.visuals}
    for shape in table.visuals:
        colours[shape.body].append((shape.kind, tuple(round(c, 3) for c in shape.rgba)))
    # Its material's, or its own, which comes first; not the box, since the body has looks.
    assert colours["top"] == [("mesh", (0.9, 0.1, 0.2, 1.0)), ("mesh", (0.1, 0.7, 0.1, 1.0))]
    tube = [("cylinder", (0.0, 1.0, 1.0, 1.0)), *[("sphere", (0.0, 1.0, 1.0, 1.0))] * 2]
    assert colours["leg_fr"] == tube  # a capsule, for nothing else of it can be seen


def test_rays_without_the_trunk_pass_through_all_that_is_fixed_to_it(tmp_path):
    mast = '<body name="mast" pos="0 0 0.3"><geom type="sphere" size="0.1" mass="0.1"/></body>'
    spec = find_robot(f"{written(tmp_path, MJCF.replace('LEGS', LEGS + mast))}/").spec
    with World(spec, FLAT) as world:
        above = world.trunk_position + np.array([0.0, 0.0, 1.0])
        down = np.array([[0.0, 0.0, -1.0]])
        assert world.ray_robot(above, down).distance[0] == pytest.approx(0.6, abs=1e-3)
        assert np.isinf(world.ray_robot(above, down, exclude="trunk").distance[0])
        leg = world.trunk_position + np.array([0.2, -0.12, 1.0])
        assert np.isfinite(world.ray_robot(leg, down, exclude="trunk").distance[0])
        apart = world.ray_robot(np.tile(leg, (3, 1)), np.repeat(down, 3, axis=0))
        assert apart.distance.shape == (3,)
        assert world.geom_rgba[apart.geom[0]].shape == (4,)


def test_a_trunk_is_as_long_as_it_looks(tmp_path):
    start = TABLE.index('<geom type="box"')
    bare = TABLE[:start] + '<inertial pos="0 0 0" mass="6" diaginertia="0.1 0.1 0.1"/>'
    bare += TABLE[TABLE.index('<geom type="mesh"') :]
    spec = find_robot(f"{written(tmp_path, bare)}/").spec
    ends = [shape.triangles.vertices[:, 0] for shape in spec.visuals if shape.triangles is not None]
    long = max(x.max() for x in ends) - min(x.min() for x in ends)
    with World(spec, FLAT) as world:
        assert world.trunk_length() == pytest.approx(long, abs=1e-6)


def test_a_spectator_sees_all_of_a_tall_robot(tmp_path):
    legs = LEGS.replace("0 0 -0.3", "0 0 -1.3").replace("0 1 1 1", "1 0 1 1")
    spec = find_robot(f"{written(tmp_path, MJCF.replace('LEGS', legs))}/").spec
    with World(spec, FLAT) as world:
        image = Spectator(FLAT, None).beside(world, NOWHERE, width=160, height=90).astype(int)
    legs_at = (image[..., 0] > image[..., 1] + 60) & (image[..., 2] > image[..., 1] + 60)
    rows = np.flatnonzero(legs_at.any(axis=1))
    assert len(rows) > 10
    assert 5 < rows[0] < rows[-1] < 85


def test_a_robot_of_primitives_alone_is_drawn_by_its_geoms_as_go1_and_go2_are(tmp_path):
    plain = MJCF.replace('type="mesh" mesh="hull"', 'type="sphere" size="0.1"')
    plain = plain.replace('type="mesh" mesh="ball"', 'type="sphere" size="0.05"')
    spec = find_robot(f"{written(tmp_path, plain.replace('LEGS', LEGS))}/").spec
    for robot in (spec, get_robot("go1"), get_robot("go2")):
        assert robot.pictured == "geoms"
        assert not [shape for shape in robot.visuals if shape.triangles is not None]
    assert [shape.kind for shape in spec.visuals] == ["sphere", "sphere"]


def test_a_robot_without_looks_is_drawn_as_what_collides(tmp_path):
    start = MJCF.index('<geom type="mesh"')
    bare = MJCF[:start] + MJCF[MJCF.index("LEGS") :]
    spec = find_robot(f"{written(tmp_path, bare.replace('LEGS', LEGS))}/").spec
    assert {(shape.body, shape.kind) for shape in spec.visuals} >= {("top", "box")}
    with World(spec, FLAT) as world:
        down = np.array([[0.0, 0.0, -1.0]])
        hits = world.ray_robot(world.trunk_position + np.array([0.1, 0.0, 1.0]), down)
        assert hits.distance[0] == pytest.approx(0.97, abs=1e-4)


# Fewer faces.


def soup(mesh):
    """Return a mesh whose triangles share no corner, as many files have them."""
    corners = np.asarray(mesh.vertices)[mesh.faces].reshape(-1, 3)
    return corners, np.arange(len(corners)).reshape(-1, 3)


def tube():
    """Return a closed mesh with edges, curves and a hole."""
    ring = trimesh.creation.annulus(r_min=0.1, r_max=0.25, height=0.3, sections=400)
    for _ in range(2):
        ring = ring.subdivide()
    return ring


def outline(vertices, faces, direction):
    """Return which of a grid of parallel rays meet a mesh, and how far they go."""
    rays = RayScene(
        TriangleMesh(
            vertices=np.asarray(vertices, float),
            faces=np.asarray(faces, np.int32),
            kinds=np.zeros(len(faces), np.uint8),
        )
    )
    line = np.linspace(-0.3, 0.3, 121) + 0.0007  # along no edge
    u, v = (axis for axis in np.eye(3) if not axis @ direction)
    across = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    origins = across[:, :1] * u + across[:, 1:] * v - direction
    distance, face = rays.cast(origins, np.broadcast_to(direction, origins.shape))
    return face >= 0, distance


@pytest.mark.parametrize(("most", "share"), [(400, 0.04), (1500, 0.02), (6000, 0.01)])
def test_a_thinned_mesh_has_no_more_faces_and_nearly_the_same_outline(most, share):
    mesh = soup(tube())
    fewer = thinned(*mesh, most)
    assert 0.4 * most < len(fewer.faces) <= most
    radius = np.hypot(*fewer.vertices[:, :2].T)
    height = np.abs(fewer.vertices[:, 2])
    off = np.min([np.abs(radius - 0.1), np.abs(radius - 0.25), np.abs(height - 0.15)], axis=0)
    cell = 2.0 * np.sqrt(0.9 / most)  # the tube has 0.9 m^2, and a cell about two faces
    assert off.max() < cell / 2
    for direction in np.eye(3):
        (whole, far), (thin, near) = (
            outline(*mesh, direction),
            outline(fewer.vertices, fewer.faces, direction),
        )
        assert (whole != thin).sum() < share * whole.sum()
        assert np.percentile(np.abs(far[whole & thin] - near[whole & thin]), 95) < cell / 2


def test_a_flat_edge_stays_an_edge_where_planes_meet():
    box = trimesh.creation.box((1.0, 0.5, 0.25))
    for _ in range(5):
        box = box.subdivide()
    fewer = thinned(np.asarray(box.vertices), np.asarray(box.faces), 200)
    thin = trimesh.Trimesh(fewer.vertices, fewer.faces)
    np.testing.assert_allclose(thin.bounds, box.bounds, atol=1e-3)
    assert thin.volume == pytest.approx(box.volume, rel=0.02)


def test_a_mesh_that_is_small_enough_stays_as_it_is():
    ball = trimesh.creation.icosphere(subdivisions=2)
    same = thinned(*soup(ball), len(ball.faces))
    assert len(same.faces) == len(ball.faces)
    assert trimesh.Trimesh(same.vertices, same.faces).volume == pytest.approx(ball.volume, rel=1e-6)


@pytest.mark.parametrize(
    "vertices",
    [
        np.zeros((300, 3)),
        np.repeat(np.linspace(0.0, 1.0, 300)[:, np.newaxis], 3, axis=1),
        np.random.default_rng(3).normal(size=(300, 3)) * [1e5, 1e-12, 1.0],
        np.random.default_rng(4).normal(size=(300, 3)),
    ],
)
def test_degenerate_meshes_thin_out_to_finite_points_within_them(vertices):
    faces = np.random.default_rng(5).integers(0, 300, (900, 3))
    fewer = thinned(vertices, faces, 50)
    assert len(fewer.faces) <= 50
    assert np.isfinite(fewer.vertices).all()
    span = np.ptp(vertices, axis=0).max() / 1000.0
    assert (fewer.vertices >= vertices.min(axis=0) - span - 1e-6).all() or not len(fewer.faces)


def test_faces_are_shared_out_by_size_and_never_over_the_bound():
    assert shares([10, 20], [0.1, 0.2], 30) == [10, 20]
    large, small, tiny = shares([50_000, 50_000, 12], [0.9, 0.1, 0.5], 20_000)
    assert large + small + tiny <= 20_000
    assert tiny == 12
    assert large == pytest.approx(9 * small, rel=0.01)
    assert sum(shares([200_000] * 400, [0.0003] * 399 + [2.0])) <= MOST_FACES


def test_a_mesh_is_thinned_once_and_damage_in_the_cache_costs_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    mesh = soup(tube())
    first = kept_thinned(*mesh, 500)
    (kept,) = (tmp_path / "cache" / "robots").iterdir()
    with np.load(io.BytesIO(kept.read_bytes())) as held:
        key = held["key"]
    other = Triangles.of(np.eye(3), np.array([[0, 1, 2]]))
    with sealed_path(kept) as path, path.open("wb") as file:
        np.savez(file, key=key, vertices=other.vertices, faces=other.faces)
    assert kept_thinned(*mesh, 500) == other  # what is kept is what is used
    kept.write_bytes(kept.read_bytes()[:-7])
    assert kept_thinned(*mesh, 500) == first
    assert kept_thinned(*mesh, 400) != first


def test_a_robot_looks_the_same_where_no_cache_can_be_written(tmp_path, monkeypatch, table):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "table" / "robot.yaml"))
    assert find_robot(f"{written(tmp_path / 'twin')}/").spec.visuals == table.visuals


# URDF.

URDF = """
<robot name="stick">
  <material name="blue"><color rgba="0.1 0.2 0.9 1"/></material>
  <link name="base">
    VISUAL
    <collision><geometry><box size="0.3 0.2 0.1"/></geometry></collision></link>
  <link name="foot"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.3"/><geometry><sphere radius="0.04"/></geometry></collision>
  </link>
  <joint name="hip" type="revolute"><parent link="base"/><child link="foot"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="33" velocity="5"/></joint>
</robot>
"""
SEEN = """<visual><origin xyz="0 0 0.2"/><geometry><mesh filename="package://stick/hull.stl"
    scale="0.1 0.1 0.1"/></geometry><material name="blue"/></visual>"""


def test_visual_elements_of_a_urdf_are_drawn_and_weigh_nothing(tmp_path):
    bare = find_robot(f"{written(tmp_path / 'bare', URDF.replace('VISUAL', ''))}/")
    found = find_robot(f"{written(tmp_path / 'seen', URDF.replace('VISUAL', SEEN))}/")
    models = [mujoco.MjModel.from_xml_string(each.spec.mjcf) for each in (found, bare)]
    for key in ("body_mass", "body_inertia", "geom_size", "geom_pos", "geom_type", "geom_contype"):
        np.testing.assert_array_equal(*(getattr(model, key) for model in models))
    assert [(shape.kind, shape.body) for shape in found.spec.visuals] == [
        ("mesh", "base"),
        ("sphere", "foot"),
    ]
    np.testing.assert_allclose(found.spec.visuals[0].rgba, (0.1, 0.2, 0.9, 1.0), atol=1e-6)
    low, high = (
        getattr(found.spec.visuals[0].triangles.vertices, end)(axis=0) for end in ("min", "max")
    )
    np.testing.assert_allclose(low, (-0.1, -0.1, 0.2), atol=1e-3)
    np.testing.assert_allclose(high, (0.1, 0.1, 0.4), atol=1e-3)
    assert not [note for note in found.notes if "drawn" in note]
    assert found.identity != bare.identity


def damaged(folder, name, corners):
    """Write an STL of some triangles."""
    triangles = np.asarray(corners, np.float32).reshape(-1, 3, 3)
    rows = np.zeros(
        len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("end", "<u2")]
    )
    rows["corners"] = triangles
    (folder / name).write_bytes(bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())


@pytest.mark.parametrize(
    ("name", "corners", "why"),
    [
        ("hull.ply", None, "only STL, OBJ and COLLADA are read"),
        ("hull.dae", None, "it is not in the folder"),
        ("gone.stl", None, "it is not in the folder"),
        ("../out.stl", None, "it is not in the folder"),
        ("nan.stl", [[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], "numbers that are not lengths"),
        ("huge.stl", [[0, 0, 0], [1e30, 0, 0], [0, 1, 0]], "numbers that are not lengths"),
        ("flat.stl", [[0, 0, 0], [1, 0, 0], [0, 1, 0]] * 4, "MuJoCo says"),
    ],
)
def test_looks_that_cannot_be_read_cost_a_note_and_no_robot(tmp_path, name, corners, why):
    folder = written(tmp_path / "stick", URDF.replace("VISUAL", SEEN.replace("hull.stl", name)))
    if corners is not None:
        damaged(folder, name, corners)
    found = find_robot(f"{folder}/")
    (note,) = [note for note in found.notes if "drawn" in note]
    assert why in note
    assert [(shape.kind, shape.body) for shape in found.spec.visuals] == [
        ("box", "base"),
        ("sphere", "foot"),
    ]


def test_a_run_says_what_of_its_robot_is_not_drawn(tmp_path):
    written(tmp_path / "table", URDF.replace("VISUAL", SEEN.replace("hull.stl", "hull.ply")))
    (tmp_path / "still").mkdir()
    (tmp_path / "still" / "policy.yaml").write_text(STILL)
    (tmp_path / "tables.yaml").write_text(SUITE.replace("trials: 2", "trials: 1"))
    said = []

    class Ear(NullListener):
        def message(self, text):
            said.append(text)

    api.run(tmp_path / "tables.yaml", out=tmp_path / "run", workers=1, listener=Ear())
    assert said[0].startswith("robot table: visual mesh 'hull.ply' is not drawn: only STL, OBJ")


# Logs.


def test_logs_hold_the_triangles_in_the_frames_of_bodies(table):
    update = SceneUpdate.FromString(robot_update(table.bodies, table.visuals))
    top = next(entity for entity in update.entities if entity.frame_id == "top")
    shape = table.visuals[0]
    points = np.array([(p.x, p.y, p.z) for p in top.triangles[0].points])
    np.testing.assert_array_equal(points, shape.triangles.vertices)
    np.testing.assert_array_equal(top.triangles[0].indices, shape.triangles.faces.ravel())
    colour = top.triangles[0].color
    assert (colour.r, colour.g, colour.b) == pytest.approx((0.9, 0.1, 0.2))
    assert len(top.triangles) == 2
    assert not top.cubes
    assert set(robot_clouds(table.bodies, table.visuals)) == set(table.bodies)
    # And so does the browser's page.
    drawn = triangles_of(top)
    np.testing.assert_array_equal(drawn[0][0], shape.triangles.vertices)
    np.testing.assert_array_equal(drawn[0][1], shape.triangles.faces)
    assert drawn[0][2] == pytest.approx((230, 26, 51), abs=1)


def test_recordings_of_rerun_hold_the_triangles(table):
    pytest.importorskip("rerun", reason="needs the extra rerun")
    update = SceneUpdate.FromString(robot_update(table.bodies, table.visuals))
    mesh = archetypes(next(e for e in update.entities if e.frame_id == "top"))["mesh"]
    own = table.visuals[0].triangles
    corners = np.array(mesh.vertex_positions.as_arrow_array().to_pylist())
    np.testing.assert_array_equal(corners, own.vertices[own.faces].reshape(-1, 3))


SUITE = """\
nw-eval: 1
name: tables
robot: ./table
policy: ./still
trials: 2
seed: 1
episode: {duration: 0.2}
scenes: [flat/carpet_room]
record: all
"""
STILL = """\
nw-policy: 1
name: still
robot: table
adapter: zero
control: {action: joint_position_offset, scale: 0.25}
"""


def test_logs_are_the_same_bytes_with_one_worker_and_with_two(tmp_path):
    written(tmp_path / "table")
    (tmp_path / "still").mkdir()
    (tmp_path / "still" / "policy.yaml").write_text(STILL)
    (tmp_path / "tables.yaml").write_text(SUITE)
    logs = []
    for workers in (1, 2):
        run = api.run(tmp_path / "tables.yaml", out=tmp_path / f"{workers}", workers=workers)
        assert len(run.rows) == 2
        files = sorted((tmp_path / f"{workers}").rglob("*.mcap"))
        logs.append([file.read_bytes() for file in files])
    assert len(logs[0]) == 2
    assert logs[0] == logs[1]
    scene = next(m for topic, _, m in LogReader(files[0]).messages() if topic == "/scene")
    assert sum(len(e.triangles) for e in scene.entities if e.id.startswith("robot/")) == 2


# Robots of others.


@pytest.mark.assets
@pytest.mark.parametrize(
    ("name", "model", "least"), [("b2", "b2.xml", 600), ("g1", "g1_12dof.xml", 400)]
)
def test_robots_of_others_are_drawn_where_their_meshes_are(tmp_path, name, model, least):
    own = ASSETS / "robots" / name
    if not own.is_dir():
        pytest.skip(f"needs {own}")
    shutil.copytree(own, tmp_path / name)
    (tmp_path / name / "robot.yaml").write_text(
        f"nw-robot: 1\nname: {name}\nmodel: {{file: {model}}}\nmotors: [{{joints: '*', kp: 100}}]\n"
    )
    spec = find_robot(f"{tmp_path / name}/").spec
    faces = [len(shape.triangles.faces) for shape in spec.visuals if shape.triangles is not None]
    assert 15_000 < sum(faces) <= MOST_FACES
    physics = mujoco.MjModel.from_xml_string(spec.mjcf)
    assert physics.nmesh == len(set(physics.geom_dataid.tolist()) - {-1})
    assert (physics.geom_contype == 1).all()
    wrong = seen = 0
    gaps = []
    with World(spec, FLAT) as world:
        world.reset(position=(0.3, 0.1, 1.2), yaw=0.4)
        their_model, data = theirs(own / model, world)
        # What is only seen, and what collides of bodies that have nothing else: B2's feet.
        looks = their_model.geom_contype == 0
        bodies = their_model.geom_bodyid
        looks |= ~np.isin(bodies, bodies[looks])
        their_model.geom_group[:] = np.where(looks, 1, 5)
        for origin, directions in rays_at(world.trunk_position, reach=0.8):
            hits = world.ray_robot(origin, directions)
            expected = met(their_model, data, origin, directions, 1)
            wrong += int((np.isfinite(hits.distance) != np.isfinite(expected)).sum())
            seen += int(np.isfinite(expected).sum())
            both = np.isfinite(hits.distance) & np.isfinite(expected)
            gaps.append(np.abs(hits.distance[both] - expected[both]))
    assert seen > least
    assert wrong < 0.05 * seen  # of the outline
    apart = np.concatenate(gaps)
    assert np.median(apart) < 0.002
    assert np.percentile(apart, 90) < 0.01
