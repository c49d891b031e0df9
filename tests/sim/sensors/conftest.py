"""Small places to sense: a plane, and boxes on it."""

import numpy as np
import pytest

from nw_policies.cards import Card
from nw_scenes import Box, Scene
from nw_scenes.mesh import box_mesh, merge, quad_mesh
from nw_scenes.robots import get_robot
from nw_sim.physics import World
from nw_sim.sensors import StepContext
from nw_sim.tasks import Course


def make_place(*boxes, trail=((2.0, 0.0, 0.0), (4.0, 0.0, 0.0))):
    """A plane at z = 0 with boxes (center, half_size) that can be touched and seen by rays."""
    solids = tuple(Box(center=center, half_size=half) for center, half in boxes)
    parts = [quad_mesh((-20, -20, 0), (60, 0, 0), (0, 40, 0), "ground")]
    parts += [box_mesh(b.center, b.half_size, b.quat, "obstacle") for b in solids]
    return Scene(
        name="hurdles/test",
        task="hurdles",
        title="a test",
        solids=solids,
        trail=np.array(trail, dtype=np.float64),
        static_mesh=merge(parts),
        splat=None,
    )


def make_card(observations, **fields):
    control = {"action": "joint_position_offset", "scale": 0.25} | fields.pop("control", {})
    return Card.model_validate(
        {
            "nw-policy": 1,
            "name": "c",
            "robot": "go1",
            "adapter": "zero",
            "control": control,
            "observations": observations,
        }
        | fields
    )


def make_moment(world, step=0, applied=0.0, output=0.0):
    return StepContext(
        world=world,
        task=Course.along(world.scene.trail),
        step=step,
        applied_action=np.full(12, applied),
        last_output=np.full(12, output),
    )


@pytest.fixture
def place():
    return make_place


@pytest.fixture
def card_of():
    return make_card


@pytest.fixture
def moment_of():
    return make_moment


@pytest.fixture
def world():
    """A Go1 that has fallen to the ground and turned a little, so that nothing is zero."""
    with World(get_robot("go1"), make_place()) as world:
        world.reset(position=(0.3, -0.2, 0.33), yaw=0.4)
        push = np.array(world.robot.default_pose)
        for step in range(25):
            world.step(push + 0.1 * np.sin(0.5 * step + np.arange(12)))
        yield world
