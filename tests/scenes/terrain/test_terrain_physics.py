"""Terrain under MuJoCo: what is attached is what was compiled, and things rest on it."""

import mujoco
import numpy as np
import pytest

from nw_scenes.attach import add_height_field, add_primitive, add_triangles
from nw_scenes.grid import TerrainOptions
from nw_scenes.mesh import box_mesh, merge, quad_mesh
from nw_scenes.scene import Box, HeightField, Primitive, Triangles
from nw_scenes.terrain import build_terrain

DOWN = np.array([0.0, 0.0, -1.0])


def attach(spec, solids):
    for index, solid in enumerate(solids):
        arguments = {"friction": solid.friction, "priority": 0}
        if isinstance(solid, HeightField):
            add_height_field(spec, f"solid_{index}", solid, **arguments)
        elif isinstance(solid, Triangles):
            add_triangles(spec, f"solid_{index}", solid, **arguments)
        elif isinstance(solid, Primitive):
            add_primitive(spec, f"solid_{index}", solid, **arguments)
        else:
            assert isinstance(solid, Box)
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=solid.half_size,
                pos=solid.center,
                quat=solid.quat,
            )


def compiled(solids):
    spec = mujoco.MjSpec()
    attach(spec, solids)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def ray_height(model, data, x, y, top=5.0):
    geom = np.zeros(1, dtype=np.int32)
    return top - mujoco.mj_ray(model, data, np.array([x, y, top]), DOWN, None, 1, -1, geom)


def settled(solids, positions, radius=0.02, steps=600):
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.005
    attach(spec, solids)
    for position in positions:
        body = spec.worldbody.add_body(pos=position)
        body.add_freejoint()
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], margin=0.0005, conaffinity=0
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    model.dof_damping[:] = np.tile([0.05] * 3 + [1e-4] * 3, len(positions))
    mujoco.mj_step(model, data, steps)
    return data.qpos.reshape(-1, 7)[:, :3].copy()


def test_a_height_field_is_to_mujoco_what_it_says_it_is():
    random = np.random.default_rng(0)
    field = HeightField(
        center=(1.0, -0.5),
        half_size=(1.0, 0.6),
        heights=random.normal(0.3, 0.1, (13, 21)).astype(np.float32),
        floor=-1.0,
    )
    model, data = compiled([field])
    points = random.uniform((0.01, -1.09), (1.99, 0.09), (300, 2))
    found = [ray_height(model, data, x, y) for x, y in points]
    assert found == pytest.approx(field.height(points).tolist(), abs=1e-6)


def test_heights_outside_the_grid_are_minus_infinity():
    field = HeightField(
        center=(0.0, 0.0), half_size=(1.0, 1.0), heights=np.zeros((3, 3), np.float32), floor=-1.0
    )
    assert field.height(np.array([[1.01, 0.0], [0.0, -1.01]])).tolist() == [-np.inf, -np.inf]
    assert field.height(np.array([[1.0, 1.0]])).tolist() == [0.0]


def test_flat_ground_of_no_range_is_attached_at_its_height():
    field = HeightField(
        center=(0.0, 0.0),
        half_size=(1.0, 1.0),
        heights=np.full((5, 5), -0.37, np.float32),
        floor=-1.0,
    )
    model, data = compiled([field])
    assert ray_height(model, data, 0.1, 0.2) == pytest.approx(-0.37, abs=1e-6)


@pytest.mark.parametrize(
    ("solid", "x", "top"),
    [
        (Primitive(kind="sphere", center=(1, 0, 0.2), size=(0.3,)), 1.0, 0.5),
        (Primitive(kind="cylinder", center=(1, 0, 0.2), size=(0.3, 0.1)), 1.2, 0.3),
        (Primitive(kind="capsule", center=(1, 0, 0.2), size=(0.1, 0.2)), 1.0, 0.5),
        (Primitive(kind="ellipsoid", center=(1, 0, 0.2), size=(0.3, 0.3, 0.1)), 1.0, 0.3),
    ],
)
def test_round_primitives_are_as_high_as_they_say(solid, x, top):
    model, data = compiled([solid])
    assert ray_height(model, data, x, 0.0) == pytest.approx(top, abs=1e-6)


def step_scene(collision):
    ground = quad_mesh((-5, -5, 0), (10, 0, 0), (0, 10, 0), "ground")
    step = box_mesh((2.5, 0, 0.1), (0.5, 0.7, 0.1), (1, 0, 0, 0), "obstacle")
    return build_terrain(
        merge([ground, step]),
        trail=np.array([[2.5, 0.0, 0.2]]),
        spawn=np.zeros(3),
        options=TerrainOptions(collision=collision),
    ).solids


@pytest.mark.parametrize("collision", ["terrain", "triangles"])
def test_spheres_rest_at_the_height_of_floor_and_tread_right_up_to_the_edge(collision):
    positions = [(1.0, 0.1, 0.03), (1.975, 0.0, 0.03), (2.015, -0.2, 0.23), (2.5, 0.3, 0.23)]
    rest = settled(step_scene(collision), positions)
    assert rest[:, :2] == pytest.approx(np.array(positions)[:, :2], abs=5e-3)
    # Margin and compliance alone lift a sphere by less than 2 mm (reference: a plane, 1.6 mm).
    assert rest[:, 2] == pytest.approx([0.02, 0.02, 0.22, 0.22], abs=2.5e-3)


# Where two slopes meet, samples know it to one of their distances: apart by a median of 5.7 mm at
# the usual 12.5 mm, 0.7 mm at 6 mm and 0.2 mm at 3 mm.
@pytest.mark.parametrize(("spacing", "bound"), [(0.0125, 8e-3), (0.006, 3e-3)])
def test_height_field_and_triangles_agree_on_a_rough_slope(spacing, bound):
    random = np.random.default_rng(2)
    X, Y = np.meshgrid(np.linspace(-1, 3, 60), np.linspace(-1, 1, 30))
    Z = 0.05 * X + random.normal(0, 0.01, X.shape)
    index = np.arange(X.size).reshape(X.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    mesh = merge([])
    mesh = type(mesh)(
        vertices=np.stack([X, Y, Z], -1).reshape(-1, 3),
        faces=faces.astype(np.int32),
        kinds=np.zeros(len(faces), dtype=np.uint8),
    )
    positions = [(x, y, 0.05 * x + 0.06) for x in (0.2, 0.9, 1.6) for y in (-0.3, 0.4)]
    rests = [
        settled(
            build_terrain(
                mesh,
                trail=np.array([[2.0, 0, 0.1]]),
                spawn=np.zeros(3),
                options=TerrainOptions(collision=collision, spacing=spacing),
            ).solids,
            positions,
        )
        for collision in ("terrain", "triangles")
    ]
    assert np.median(np.linalg.norm(rests[0] - rests[1], axis=1)) < bound
    assert np.median(np.abs(rests[0] - rests[1])[:, 2]) < 1.5e-3


def test_a_small_field_of_another_model_is_ground_also_where_a_mesh_follows_it():
    field = HeightField(
        center=(0.0, 0.0), half_size=(1.0, 1.0), heights=np.full((2, 2), 0.1, np.float32), floor=-1
    )
    tetrahedron = Triangles(
        vertices=np.array([[0, 0, 9], [1, 0, 9], [0, 1, 9], [0, 0, 10]], dtype=np.float32),
        faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32),
    )
    spec = mujoco.MjSpec()
    attach(spec, [field])
    spec.add_mesh(
        name="other",
        uservert=tetrahedron.vertices.astype(float).ravel().tolist(),
        userface=tetrahedron.faces.ravel().tolist(),
    )
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="other", contype=0)
    body = spec.worldbody.add_body(pos=[0.2, 0.3, 0.15])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], conaffinity=1)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 400)
    assert data.qpos[2] == pytest.approx(0.12, abs=1e-3)
