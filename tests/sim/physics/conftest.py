"""Small places to test physics in."""

import numpy as np
import pytest

from nw_scenes.mesh import TriangleMesh
from nw_scenes.robots import get_robot
from nw_scenes.scene import Box, Scene

NO_MESH = TriangleMesh(
    vertices=np.zeros((0, 3)),
    faces=np.zeros((0, 3), dtype=np.int32),
    kinds=np.zeros(0, dtype=np.uint8),
)


@pytest.fixture(scope="session")
def go1():
    return get_robot("go1")


@pytest.fixture(scope="session")
def place():
    """Make a scene from boxes, given as (center, half_size), and waypoints."""

    def make(*boxes, trail=((4.0, 0.0, 0.0),)):
        return Scene(
            name="tests/place",
            task="hurdles",
            title="A place for tests",
            solids=tuple(Box(center=center, half_size=half) for center, half in boxes),
            trail=np.array(trail),
            static_mesh=NO_MESH,
            splat=None,
        )

    return make


@pytest.fixture(scope="session")
def flat(place):
    return place()


@pytest.fixture(scope="session")
def swing(go1):
    """Joint targets that make the robot move about, as a function of the control step."""

    def targets(step):
        return np.array(go1.default_pose) + 0.3 * np.sin(0.25 * step + np.arange(12))

    return targets
