"""A street of planes by exact rays: ground seen at a grazing angle, a plain wall, moving clouds."""

import numpy as np
from PIL import Image
from twin_parts import captured, placed

from nw_splat.camera import Camera, look_at
from nw_twin.capture import write_capture

WIDTH, HEIGHT = 144, 112
EYE = 1.5
"""Height of the camera above the ground, metres."""
WALL_Y, WALL_X, WALL_Z = 7.0, (-1.2, 2.4), 2.6
"""A wall across the way: where, from and to, and how high; metres."""
BORDER = 0.35
"""Textured rim of the wall, metres; inside it is plain."""
WALKER_Y, WALKER_SIZE = 3.6, (0.5, 1.7)
"""Somebody who walks across before the wall: where, how wide and high; metres."""
GROUND, RIM, PLAIN, SKY = range(4)


def _texture(points, seed):
    """Smooth noise of three octaves at points (N, 2) in metres, 0 to 1."""
    rng, total = np.random.default_rng(seed), np.zeros(len(points))
    for cell in (0.24, 0.12, 0.06):
        table = rng.normal(size=(64, 64))
        at = points / cell
        low = np.floor(at).astype(int)
        u, v = (at - low).T
        i, j = low.T % 64
        top = table[i, j] * (1 - u) + table[(i + 1) % 64, j] * u
        end = table[i, (j + 1) % 64] * (1 - u) + table[(i + 1) % 64, (j + 1) % 64] * u
        total += top * (1 - v) + end * v
    return np.clip(0.5 + 0.16 * total, 0.0, 1.0)


def _rays(camera, fine):
    """Return the eye and a ray (N, 3) through each of fine * fine points of a pixel, 1 deep."""
    u, v = ((np.arange(n * fine) + 0.5) / fine for n in (WIDTH, HEIGHT))
    x, y = np.meshgrid((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    return camera.T_world_camera[:3, 3], rays @ camera.T_world_camera[:3, :3].T


def seen(camera, fine=1):
    """Return depth along the optical axis, what is seen, the normal in the world, and points."""
    eye, rays = _rays(camera, fine)
    with np.errstate(divide="ignore", invalid="ignore"):
        down, ahead = -eye[2] / rays[:, 2], (WALL_Y - eye[1]) / rays[:, 1]
        at = eye + ahead[:, None] * rays
    wall = (ahead > 0) & (at[:, 0] > WALL_X[0]) & (at[:, 0] < WALL_X[1])
    wall &= (at[:, 2] > 0) & (at[:, 2] < WALL_Z)
    depth = np.where(wall, ahead, np.where(down > 0, down, np.inf))
    points = eye + np.where(np.isfinite(depth), depth, 0.0)[:, None] * rays
    inner = (points[:, 0] > WALL_X[0] + BORDER) & (points[:, 0] < WALL_X[1] - BORDER)
    inner &= points[:, 2] < WALL_Z - BORDER
    what = np.where(np.isinf(depth), SKY, np.where(wall, np.where(inner, PLAIN, RIM), GROUND))
    normal = np.where(wall[:, None], (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
    return depth, what, normal, points


def walker_seen(camera, number, fine=1):
    """Return where a picture shows the one who walks, (N,) bool, and points on him, (N, 2) m."""
    eye, rays = _rays(camera, fine)
    ahead = (WALKER_Y - eye[1]) / rays[:, 1]
    at = (eye + ahead[:, None] * rays)[:, [0, 2]]
    at[:, 0] -= -0.9 + 0.45 * number  # A step in each picture.
    wide, high = WALKER_SIZE
    return (ahead > 0) & (np.abs(at[:, 0]) < wide / 2) & (at[:, 1] > 0) & (at[:, 1] < high), at


def photographed(camera, number, fine=2, walks=False):
    """Return a picture (H, W, 3) uint8; its clouds are where they are in no other."""
    _, what, _, points = seen(camera, fine)
    grey = np.full(len(points), 0.7)
    grey[what == GROUND] = _texture(points[what == GROUND, :2], 1)
    grey[what == RIM] = _texture(points[what == RIM][:, [0, 2]], 2)
    clouds = np.random.default_rng(number).normal(size=(HEIGHT // 8, WIDTH // 8))
    clouds = np.kron(clouds, np.ones((8 * fine, 8 * fine))).ravel()
    grey[what == SKY] = (0.9 + 0.05 * clouds)[what == SKY]
    if walks:
        there, at = walker_seen(camera, number, fine)
        grey[there] = _texture(at[there], 3)
    shown = grey.reshape(HEIGHT, fine, WIDTH, fine).mean(axis=(1, 3))
    noise = np.random.default_rng(100 + number).normal(0.0, 0.006, shown.shape)
    return np.repeat(np.uint8(255 * np.clip(shown + noise, 0, 1))[..., None], 3, axis=-1)


def write_street(folder, count=5, walks=False):
    """Photograph a walk towards the wall into a capture's folder; return the capture.

    Args:
        folder: of the capture.
        count: photographs.
        walks: whether somebody walks across before the wall, a step further in each photograph.
    """
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-2, 2, 300), rng.uniform(1, 7, 300), np.zeros(300)])
    rim = np.column_stack(
        [rng.uniform(*WALL_X, 300), np.full(300, WALL_Y), rng.uniform(0, 2.6, 300)]
    )
    inner = (np.abs(rim[:, 0] - 0.6) < 1.8 - BORDER) & (rim[:, 2] < WALL_Z - BORDER)
    points = np.vstack([ground, rim[~inner]]) + rng.normal(0.0, 0.003, (300 + (~inner).sum(), 3))
    (folder / "pictures").mkdir(parents=True)
    shots = []
    for n in range(count):
        eye = np.array([0.25 * (-1) ** n, -1.2 + 0.6 * n, EYE])
        T = look_at(eye, eye + np.array([0.0, 1.0, -0.2]))
        camera = Camera.from_fovy(width=WIDTH, height=HEIGHT, fovy=0.9, T_world_camera=T)
        Image.fromarray(photographed(camera, n, walks=walks)).save(folder / f"pictures/{n}.png")
        local = points @ camera.T_camera_world[:3, :3].T + camera.T_camera_world[:3, 3]
        u = camera.fx * local[:, 0] / local[:, 2] + camera.cx
        v = camera.fy * local[:, 1] / local[:, 2] + camera.cy
        shown = (local[:, 2] > 0) & (u > 0) & (u < WIDTH) & (v > 0) & (v < HEIGHT)
        number = np.flatnonzero(shown)
        shots.append(placed(f"{n}.jpg", camera, number, file=f"pictures/{n}.png"))
    capture = captured(shots, points)
    write_capture(capture, folder)
    return capture
