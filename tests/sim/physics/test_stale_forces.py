"""The published protocol's stale contact forces, made the same everywhere."""

import hashlib
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from nw_sim.physics import World
from nw_sim.physics.forces import ContactForces

SCRIPT = """\
import hashlib, numpy as np
from nw_base.protocol import NEVERWHERE_2026
from nw_scenes.robots import get_robot
from nw_scenes import Scene
from nw_scenes.mesh import quad_mesh
from nw_sim.physics import World
scene = Scene(name="t/t", task="gaps", title="", solids=(), trail=np.zeros((1, 3)), splat=None,
              static_mesh=quad_mesh((0, 0, 0), (1, 0, 0), (0, 1, 0), "ground"))
digest, robot = hashlib.sha256(), get_robot("go1")
with World(robot, scene, protocol=NEVERWHERE_2026) as world:
    for step in range(60):
        world.step(np.array(robot.default_pose) + 0.4 * np.sin(0.4 * step + np.arange(12)))
        digest.update(world.foot_forces().tobytes())
print(digest.hexdigest())
"""


def digest_with(perturbation):
    """Run the script in a process whose fresh memory is filled with some byte."""
    environment = os.environ | {"MALLOC_PERTURB_": str(perturbation), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def test_forces_do_not_depend_on_what_lies_in_memory():
    digests = {digest_with(byte) for byte in (0, 90, 165)}
    assert len(digests) == 1
    assert digests != {hashlib.sha256().hexdigest()}


def test_a_contact_beyond_the_last_solve_reads_zero(go1, flat):
    with World(go1, flat) as world:
        for _ in range(50):
            world.step(go1.default_pose)
        reader = ContactForces(world._model, go1, go1.feet, in_contact_frames=True)
        solved = world._data.efc_force.copy()
        assert (reader.read(world._data, solved) > 10.0).all()
        last = int(world._data.contact.efc_address.max())
        forces = reader.read(world._data, solved[:last])
        assert (forces == 0.0).sum() == 1
        np.testing.assert_array_equal(reader.read(world._data, np.zeros(0)), 0.0)


@pytest.mark.parametrize("in_contact_frames", [True, False])
def test_fresh_forces_are_mujocos_own(go1, flat, swing, in_contact_frames):
    with World(go1, flat) as world:
        model, data = world._model, world._data
        reader = ContactForces(model, go1, go1.feet, in_contact_frames=in_contact_frames)
        touched = 0
        for step in range(40):
            world.step(swing(step))
            sums = {model.geom(name).id: np.zeros(3) for name in go1.feet}
            for index in range(data.ncon):
                wrench = np.zeros(6)
                mujoco.mj_contactForce(model, data, index, wrench)
                first, second = data.contact.geom[index]
                frame = data.contact.frame[index].reshape(3, 3)
                for geom, sign in ((first, -1.0), (second, 1.0)):
                    if geom in sums:
                        touched += 1
                        turned = sign * (wrench[:3] @ frame)
                        sums[geom] += wrench[:3] if in_contact_frames else turned
            expected = [np.linalg.norm(force) for force in sums.values()]
            np.testing.assert_allclose(reader.read(data), expected, rtol=1e-14)
        assert touched > 20
