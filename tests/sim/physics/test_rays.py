"""Rays against the robot's visual primitives."""

import mujoco
import numpy as np
import pytest

from nw_scenes.robots.spec import VISUAL_GROUP
from nw_sim.physics import World


@pytest.fixture(scope="module")
def world(go1, place):
    # A box right in front of the robot must not stop the rays: they see the robot alone.
    with World(go1, place(((0.7, 0.0, 0.2), (0.1, 0.5, 0.2)))) as world:
        for _ in range(30):
            world.step(go1.default_pose)
        yield world


def rays(count, eye, spread=0.15):
    rng = np.random.default_rng(7)
    directions = np.array((0.0, 0.0, 0.25)) - eye + rng.normal(0.0, spread, (count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.parametrize(
    "eye", [(1.1, -0.9, 0.55), (0.0, -1.5, 0.3), (-1.0, -0.8, 0.7), (1.3, 0.1, 0.3), (0, 0, 2)]
)
def test_a_fan_meets_what_exact_primitives_say(world, eye):
    # Truth: the nearest of all primitives, one by one. MuJoCo's fan culls by body and has missed
    # primitives that stick out of a body's collision boxes, such as the head.
    eye = np.array(eye, dtype=float)
    directions = rays(300, eye)
    hits = world.ray_robot(eye, directions)
    model, data = world._model, world._data
    seen = np.flatnonzero(model.geom_group == VISUAL_GROUP)
    for direction, distance, geom, normal in zip(directions, *hits, strict=True):
        normals = np.zeros((len(seen), 3))
        distances = np.array(
            [
                mujoco.mju_rayGeom(
                    data.geom_xpos[g],
                    data.geom_xmat[g],
                    model.geom_size[g],
                    eye,
                    direction,
                    int(model.geom_type[g]),
                    normals[row],
                )
                for row, g in enumerate(seen)
            ]
        )
        distances[distances < 0] = np.inf
        nearest = distances.argmin()
        assert distance == pytest.approx(distances[nearest], abs=1e-9)
        if np.isfinite(distance):
            assert geom == seen[nearest]
            np.testing.assert_allclose(normal, normals[nearest], atol=1e-9)
            assert normal @ direction < 1e-9
    assert np.isfinite(hits.distance).sum() > 50


def test_misses_are_infinite_and_have_no_geom(world):
    hits = world.ray_robot(np.array((0.0, 0.0, 3.0)), np.array([[0.0, 0.0, 1.0]] * 5))
    assert np.isinf(hits.distance).all()
    assert (hits.geom == -1).all()
    assert not hits.normal.any()


def test_rays_with_their_own_origins_agree_with_the_fan(world):
    eye = np.array((1.1, -0.9, 0.55))
    directions = rays(100, eye)
    fan = world.ray_robot(eye, directions)
    apart = world.ray_robot(np.tile(eye, (100, 1)), directions)
    np.testing.assert_array_equal(fan.distance, apart.distance)
    np.testing.assert_array_equal(fan.geom, apart.geom)


def test_a_camera_in_the_head_can_look_through_it(world):
    pose = world.camera_pose("ego")
    ahead = pose[:3, 2][None]
    assert world.ray_robot(pose[:3, 3], ahead).distance[0] < 0.1
    assert np.isinf(world.ray_robot(pose[:3, 3], ahead, exclude="trunk").distance[0])


def test_every_hit_has_a_colour(world):
    eye = np.array((1.1, -0.9, 0.55))
    hits = world.ray_robot(eye, rays(300, eye))
    colours = world.geom_rgba[hits.geom[hits.geom >= 0]]
    assert colours.shape[1] == 4
    np.testing.assert_array_equal(colours[:, 3], 1.0)
    assert len(np.unique(colours, axis=0)) >= 3


def test_no_rays_is_no_error(world):
    assert world.ray_robot(np.zeros(3), np.zeros((0, 3))).distance.shape == (0,)
