"""What each sensor costs on one core, in a scan mesh of 50,000 triangles.

    python tests/bench/bench_sensors.py

A Go1 stands in a synthetic scan (bumpy ground with two steps, walls around it, 2 mm of noise);
every figure is the best of five runs. The last line is everything that the shipped policy
go1-parkour observes in one control step, in a built-in scene.
"""

from __future__ import annotations

import time

import numpy as np

from nw_policies import load_bundle
from nw_policies.cards import Card
from nw_scenes import Scene
from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.rays import RayScene
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.sensors import StepContext, build_sensors
from nw_sim.tasks import Course

COLUMNS, ROWS = 250, 101  # of the scan's vertices: 49,800 triangles
TRAIL = np.array([[2.0, 0.0, 0.15], [4.0, 0.0, 0.30]])
# Observation, and the milliseconds that it may take on one core.
CASES = {
    "depth 80 x 45": ({"sensor": "depth"}, 1.5),
    "depth 80 x 45, cones and robot": ({"sensor": "depth", "cones": True, "robot": True}, None),
    "depth 320 x 180": ({"sensor": "depth", "width": 320, "height": 180}, 12.0),
    "semantics 80 x 45": ({"sensor": "semantics"}, None),
    "semantics 320 x 180": ({"sensor": "semantics", "width": 320, "height": 180}, None),
    "scandots 12 x 11": ({"sensor": "scandots"}, 0.060),
    "heightmap 31 x 21": ({"sensor": "heightmap"}, None),
    "lidar spinning, 16 x 1800": ({"sensor": "lidar"}, 12.0),
    "lidar solid state, 120 x 240": (
        {"sensor": "lidar", "pattern": "solid_state", "channels": 120, "columns": 240},
        12.0,
    ),
    "direction": ({"sensor": "direction"}, None),
}
PARKOUR_LIMIT = 0.060


def scan(seed=0):
    """Return an open mesh of irregular triangles, 9 x 3.6 m, whose borders rise to walls of 2 m."""
    random = np.random.default_rng(seed)
    x, y = np.linspace(-1.5, 7.5, COLUMNS), np.linspace(-1.8, 1.8, ROWS)
    X, Y = np.meshgrid(x, y)
    X = X + random.uniform(-0.3, 0.3, X.shape) * (x[1] - x[0])
    Y = Y + random.uniform(-0.3, 0.3, Y.shape) * (y[1] - y[0])
    Z = 0.01 * np.sin(3 * X) * np.cos(2.2 * Y) + random.normal(0, 0.002, X.shape)
    for edge in (1.8, 3.8):
        Z = Z + 0.15 / (1 + np.exp(-(X - edge) / 0.01))
    border = np.maximum(np.abs(Y) - 1.6, np.abs(X - 3.0) - 4.3)
    Z = Z + np.clip(border / 0.1, 0.0, 1.0) * 2.0
    index = np.arange(X.size).reshape(X.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    halves = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    faces = np.concatenate(halves).astype(np.int32)
    return TriangleMesh(
        vertices=np.stack([X, Y, Z], axis=-1).reshape(-1, 3),
        faces=faces,
        kinds=np.full(len(faces), FACE_KINDS.index("ground"), dtype=np.uint8),
    )


def place():
    return Scene(
        name="bench/scan",
        task="stairs",
        title="a scan",
        solids=(),
        trail=TRAIL,
        static_mesh=scan(),
        splat=None,
    )


def card(observations):
    return Card.model_validate(
        {
            "nw-policy": 1,
            "name": "bench",
            "robot": "go1",
            "adapter": "zero",
            "control": {"action": "joint_position_offset"},
            "observations": observations,
        }
    )


def milliseconds(function, *, budget=0.4, runs=5):
    """Return the best mean time of a call over several runs."""
    began = time.perf_counter()
    function()
    calls = max(1, int(budget / max(time.perf_counter() - began, 1e-6)))
    best = np.inf
    for _ in range(runs):
        began = time.perf_counter()
        for _ in range(calls):
            function()
        best = min(best, (time.perf_counter() - began) / calls)
    return best * 1e3


def observing(world, sensors):
    """Return a function that reads all sensors at a new control step each time."""
    task = Course.along(world.scene.trail)
    for sensor in sensors.values():
        sensor.reset(0)
    zeros, step = np.zeros(12), iter(range(1_000_000_000))

    def read():
        moment = StepContext(
            world=world,
            task=task,
            step=next(step),
            applied_action=zeros,
            last_output=zeros,
        )
        for sensor in sensors.values():
            sensor.read(moment)

    return read


def standing(scene):
    world = World(get_robot("go1"), scene)
    for _ in range(50):
        world.step(world.robot.default_pose)
    return world


def rows():
    """Yield what was measured, its milliseconds, and its limit or None."""
    scene = place()
    rays = RayScene(scene.mesh())
    with standing(scene) as world:
        for name, (observation, limit) in CASES.items():
            sensors = build_sensors(card({"it": observation}), world, rays=rays)
            yield name, milliseconds(observing(world, sensors)), limit
    with standing(get_scene("hurdles/two_logs_park")) as world:
        sensors = build_sensors(load_bundle("go1-parkour").card, world)
        yield "all of go1-parkour", milliseconds(observing(world, sensors)), PARKOUR_LIMIT


def test_sensors_keep_within_their_time():
    late = []
    for name, taken, limit in rows():
        told = "" if limit is None else f"  (at most {limit:g})"
        print(f"{name:32} {taken:9.3f} ms{told}")
        if limit is not None and taken > limit:
            late.append(name)
    assert not late


if __name__ == "__main__":
    test_sensors_keep_within_their_time()
