"""Physics on terrain compiled from a scan: steps per second and contact error.

    python tests/bench/bench_terrain.py

A synthetic scan of 50,000 triangles (bumpy ground, two 15 cm steps, 2 mm of noise, irregular
triangles) under a Go1 that stands, and that trots open loop; best of five runs of 1,000 steps.
The contact error is that of 60 spheres of 2 cm at rest on the mesh, beside the offset that the
same spheres have on a plane.
"""

from __future__ import annotations

import time

import mujoco
import numpy as np

from nw_scenes.attach import add_height_field, add_triangles
from nw_scenes.grid import TerrainOptions
from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.rays import RayScene
from nw_scenes.robots import get_robot
from nw_scenes.scene import Box, HeightField, Triangles
from nw_scenes.terrain import build_terrain

TRAIL = np.array([[2.2, 0.0, 0.15], [4.2, 0.0, 0.30], [6.0, 0.0, 0.30]])
COLUMNS, ROWS = 250, 100  # of the scan's vertices: 49,302 triangles


def scan(noise=0.002, seed=0):
    """Return an open mesh of irregular triangles over x -1.5..7.5, y -1.8..1.8 m."""
    random = np.random.default_rng(seed)
    x = np.linspace(-1.5, 7.5, COLUMNS)
    y = np.linspace(-1.8, 1.8, ROWS)
    X, Y = np.meshgrid(x, y)
    X = X + random.uniform(-0.3, 0.3, X.shape) * (x[1] - x[0])
    Y = Y + random.uniform(-0.3, 0.3, Y.shape) * (y[1] - y[0])
    Z = 0.01 * np.sin(3 * X) * np.cos(2.2 * Y) + 0.004 * np.sin(17 * X) * np.sin(13 * Y)
    for edge in (2.0, 4.0):
        Z = Z + 0.15 / (1 + np.exp(-(X - edge) / 0.01))
    Z = Z + random.normal(0, noise, Z.shape)
    index = np.arange(X.size).reshape(X.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    ).astype(np.int32)
    return TriangleMesh(
        vertices=np.stack([X, Y, Z], axis=-1).reshape(-1, 3),
        faces=faces,
        kinds=np.full(len(faces), FACE_KINDS.index("ground"), dtype=np.uint8),
    )


def attach(spec, solids):
    for index, solid in enumerate(solids):
        name = f"solid_{index}"
        if isinstance(solid, HeightField):
            add_height_field(spec, name, solid, friction=solid.friction, priority=0)
        elif isinstance(solid, Triangles):
            add_triangles(spec, name, solid, friction=solid.friction, priority=0)
        else:
            assert isinstance(solid, Box)
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=solid.half_size,
                pos=solid.center,
                quat=solid.quat,
                friction=solid.friction,
            )


def options(spec):
    spec.option.timestep = 0.005
    spec.option.gravity = [0, 0, -9.806]
    spec.option.iterations = 50
    spec.option.tolerance = 1e-8


def steps_per_second(solids, *, trot, steps=1000, runs=5, start=(1.2, 0.0)):
    robot = get_robot("go1")
    spec = mujoco.MjSpec.from_string(robot.mjcf)
    options(spec)
    attach(spec, solids)
    model = spec.compile()
    pose = np.array(robot.default_pose)
    best = 0.0
    for _ in range(runs):
        data = mujoco.MjData(model)
        data.qpos[:3] = (*start, 0.4)
        data.qpos[7:] = data.ctrl[:] = pose
        mujoco.mj_step(model, data, 200)
        # Processor time: other work on the machine does not count.
        begin = time.process_time()
        for tick in range(steps // 4):
            if trot:
                data.ctrl[:] = pose + gait(tick * 0.02)
            mujoco.mj_step(model, data, 4)
        best = max(best, steps / (time.process_time() - begin))
    return best


def gait(t, frequency=2.0):
    """Return joint offsets (12,) of a trot in place, legs FR FL RR RL."""
    offsets = np.zeros(12)
    for leg, phase in enumerate((0.0, np.pi, np.pi, 0.0)):
        angle = 2 * np.pi * frequency * t + phase
        offsets[3 * leg + 1] = 0.15 * np.cos(angle)
        offsets[3 * leg + 2] = -0.35 * max(np.sin(angle), 0.0)
    return offsets


def rest_errors(solids, mesh, *, count=60, radius=0.02, seed=3):
    """Return how far spheres come to rest above the mesh, less the same on a plane, (N,) m."""
    random = np.random.default_rng(seed)
    spots = random.uniform((-0.3, -0.5), (6.0, 0.5), size=(count, 2))
    rays = RayScene(mesh)
    resting = _settle(solids, np.column_stack([spots, rays.height(spots) + radius + 0.01]), radius)
    # A sphere on a slope touches beside its lowest point: the nearest point counts.
    fan = _sphere_directions()
    errors = np.empty(count)
    for index, center in enumerate(resting):
        distance, _ = rays.cast(np.repeat(center[None], len(fan), axis=0), fan)
        errors[index] = distance.min() - radius
    plane = _settle(None, np.array([[0.0, 0.0, radius + 0.01]]), radius)[0, 2] - radius
    return errors - plane


def _settle(solids, centers, radius):
    spec = mujoco.MjSpec()
    options(spec)
    if solids is None:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], friction=[1.25, 0.3, 0.3]
        )
    else:
        attach(spec, solids)
    for index, center in enumerate(centers):
        body = spec.worldbody.add_body(name=f"ball_{index}", pos=center)
        body.add_freejoint()
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0, 0],
            margin=0.0005,
            condim=6,
            friction=[1.25, 0.3, 0.3],
            conaffinity=0,
        )
    model = spec.compile()
    # Rolling resistance alone would take minutes.
    model.dof_damping[:] = np.tile([0.02] * 3 + [1e-4] * 3, len(centers))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 600)
    return data.qpos.reshape(-1, 7)[:, :3].copy()


def _sphere_directions(count=4000):
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    turn = np.pi * (1 + 5**0.5) * index
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=-1)


def main():
    mesh = scan()
    print(f"{len(mesh.faces)} triangles")
    print("spacing  compile s  stand steps/s  trot steps/s  contact error mm: median p90 max")
    for spacing in (0.01, 0.0125, 0.015, 0.02, 0.035):
        begin = time.perf_counter()
        terrain = build_terrain(
            mesh, trail=TRAIL, spawn=np.zeros(3), options=TerrainOptions(spacing=spacing)
        )
        took = time.perf_counter() - begin
        error = 1000 * np.abs(rest_errors(terrain.solids, mesh))
        print(
            f"{spacing:7.4f}  {took:9.2f}  {steps_per_second(terrain.solids, trot=False):13.0f}"
            f"  {steps_per_second(terrain.solids, trot=True):12.0f}"
            f"  {np.median(error):.2f} {np.quantile(error, 0.9):.2f} {error.max():.2f}"
            f"   boxes {len(terrain.solids) - 2}, surface {terrain.accuracy}"
        )
    exact = build_terrain(
        mesh, trail=TRAIL, spawn=np.zeros(3), options=TerrainOptions(collision="triangles")
    )
    error = 1000 * np.abs(rest_errors(exact.solids, mesh))
    rate = steps_per_second(exact.solids, trot=True, steps=200, runs=2)
    print(
        f"   triangles        trot {rate:.0f}   {np.median(error):.2f} "
        f"{np.quantile(error, 0.9):.2f} {error.max():.2f}"
    )


if __name__ == "__main__":
    main()
