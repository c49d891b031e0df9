"""Captures of rooms whose gravity and scale are known, without a photograph."""

import math

import numpy as np
from twin_parts import captured, placed

from nw_splat.camera import Camera, look_at


def patch(rng, count, origin, u, v):
    """Return points of a parallelogram."""
    a, b = rng.random((2, count, 1))
    return np.array(origin) + a * np.array(u) + b * np.array(v)


def room(rng, *, floor=900, walls=500, ceiling=0, ramp=0, slope=14.0, table=0, stray=120):
    """Return points of a room of 6 m by 5 m; the floor is at z = 0."""
    rise = math.tan(math.radians(slope))
    parts = [
        patch(rng, floor, (0, 0, 0), (6, 0, 0), (0, 5, 0)),
        patch(rng, walls, (0, 0, 0), (6, 0, 0), (0, 0, 2.6)),
        patch(rng, walls, (0, 0, 0), (0, 5, 0), (0, 0, 2.6)),
        patch(rng, ceiling, (0, 0, 2.6), (6, 0, 0), (0, 5, 0)),
        patch(rng, ramp, (1, 1, 0), (4, 0, 4 * rise), (0, 3, 0)),
        patch(rng, table, (1, 3, 0.75), (2, 0, 0), (0, 1, 0)),
        rng.uniform((0, 0, 0), (6, 5, 2.6), (stray, 3)),
    ]
    points = np.concatenate(parts)
    return points + rng.normal(0, 0.004, points.shape)


def walk(rng, count=40, *, roll=2.5, pitch=25.0, height=1.5):
    """Return poses (N, 4, 4) of a walk round the room: looking down, held a little askew."""
    poses = []
    for i in range(count):
        turn = 2 * math.pi * i / count
        eye = np.array([3 + 1.9 * math.cos(turn), 2.5 + 1.4 * math.sin(turn), height])
        eye += rng.normal(0, 0.05, 3)
        heading = turn + rng.normal(0, 0.5) + (math.pi if i % 2 else 0.4)
        down = math.radians(pitch + rng.normal(0, 6.0))
        way = [math.cos(heading) * math.cos(down), math.sin(heading) * math.cos(down)]
        T = look_at(eye, eye + np.array([*way, -math.sin(down)]))
        T[:3, :3] = T[:3, :3] @ about_z(math.radians(rng.normal(0, roll)))
        poses.append(T)
    return np.array(poses)


def straight(rng, count=40, *, roll=1.0, pitch=20.0):
    """Return poses of a walk along x that never turns."""
    poses = []
    for x in np.linspace(0.3, 4.5, count):
        down = math.radians(pitch + rng.normal(0, 2.0))
        eye = np.array([x, 2.5, 1.4])
        T = look_at(eye, eye + np.array([math.cos(down), 0.0, -math.sin(down)]))
        T[:3, :3] = T[:3, :3] @ about_z(math.radians(rng.normal(0, roll)))
        poses.append(T)
    return np.array(poses)


def about_z(angle):
    """Return a rotation (3, 3) about z; of a camera, its roll."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def similarity(rng, scale=None):
    """Return a random rotation, scale and translation (4, 4)."""
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    T = np.eye(4)
    T[:3, :3] = rotation * (math.exp(rng.uniform(-2, 2)) if scale is None else scale)
    T[:3, 3] = rng.normal(0, 5, 3)
    return T


def camera(T, width=320, height=240):
    """Return a camera of 70 degrees."""
    T = T.copy()
    T[:3, :3] /= np.linalg.norm(T[:3, 0])
    return Camera.from_fovy(width=width, height=height, fovy=math.radians(55), T_world_camera=T)


def capture(points, poses, T=None, *, files=None, size=(320, 240)):
    """Return the capture of a place in metres, in the frame to which T leads."""
    T = np.eye(4) if T is None else T
    points = points @ T[:3, :3].T + T[:3, 3]
    shots = [
        placed(
            f"{i:03d}.jpg",
            camera(T @ pose, *size),
            range(i % 7, len(points), 7),
            file=f"{i:03d}.png" if files is None else files[i],
        )
        for i, pose in enumerate(poses)
    ]
    return captured(shots, points)


def degrees_off(alignment, T):
    """Return how far an alignment's z is from true up, degrees; T leads from metres to capture."""
    up = alignment.T_metric_capture[2, :3]
    true = T[:3, 2]
    sine = np.linalg.norm(np.cross(up, true)) / np.linalg.norm(up) / np.linalg.norm(true)
    return math.degrees(math.atan2(sine, up @ true))


def scale_off(alignment, T):
    """Return the relative error of an alignment's scale."""
    return alignment.scale * np.linalg.norm(T[:3, 0]) - 1.0


def floor_off(alignment, T):
    """Return the height that an alignment gives to the true floor's middle, metres."""
    middle = T[:3, :3] @ np.array([3.0, 2.5, 0.0]) + T[:3, 3]
    return float((alignment.T_metric_capture @ [*middle, 1.0])[2])
