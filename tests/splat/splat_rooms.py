"""Places and clouds made of random numbers, for tests and benchmarks."""

import math

import numpy as np

from nw_splat.camera import Camera, look_at
from nw_splat.gaussians import Gaussians

EYES = (
    ((-7, -7, 0.3), 0.8),
    ((0, 0, 0.3), 0.0),
    ((3, -5, 0.3), 0.9),
    ((-4, 6, 0.3), -0.7),
    ((7, 7, 0.3), -2.3),
    ((-2, -8, 0.3), 1.6),
    ((5, 1, 0.3), 3.1),
    ((0, -4, 0.3), 2.2),
)
"""A robot's places and headings in the room."""

_HFOV = math.radians(80)
_PITCH = math.radians(-8)


def eye_camera(number, width, height):
    """Return the camera of a robot at one of the places."""
    place, yaw = EYES[number % len(EYES)]
    ahead = np.array(
        [math.cos(yaw) * math.cos(_PITCH), math.sin(yaw) * math.cos(_PITCH), math.sin(_PITCH)]
    )
    focal = width / 2 / math.tan(_HFOV / 2)
    return Camera(
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=width / 2,
        cy=height / 2,
        T_world_camera=look_at(np.array(place, dtype=float), np.array(place) + ahead),
    )


def _quads(rng):
    """A 20 x 20 x 3 m room with 25 boxes and a flight of stairs: (origin, side, side) each."""
    quads = [((-10, -10, 0), (20, 0, 0), (0, 20, 0))]
    quads += [
        ((-10, -10, 0), (20, 0, 0), (0, 0, 3)),
        ((-10, 10, 0), (20, 0, 0), (0, 0, 3)),
        ((-10, -10, 0), (0, 20, 0), (0, 0, 3)),
        ((10, -10, 0), (0, 20, 0), (0, 0, 3)),
    ]
    boxes = [
        (*rng.uniform(-8, 8, 2), *rng.uniform(0.4, 1.5, 2), rng.uniform(0.2, 1.8))
        for _ in range(25)
    ]
    boxes += [(6, -3 + 0.3 * step, 2.0, 0.3, 0.17 * (step + 1)) for step in range(8)]
    for cx, cy, w, d, h in boxes:
        x, y = cx - w / 2, cy - d / 2
        quads += [
            ((x, y, h), (w, 0, 0), (0, d, 0)),
            ((x, y, 0), (w, 0, 0), (0, 0, h)),
            ((x, y + d, 0), (w, 0, 0), (0, 0, h)),
            ((x, y, 0), (0, d, 0), (0, 0, h)),
            ((x + w, y, 0), (0, d, 0), (0, 0, h)),
        ]
    return [tuple(np.array(part, dtype=float) for part in quad) for quad in quads]


def room(count, *, degree=3, seed=0):
    """Return `count` flat Gaussians on the surfaces of a room, as a trainer would leave them."""
    rng = np.random.default_rng(seed)
    quads = _quads(rng)
    area = np.array([np.linalg.norm(np.cross(u, v)) for _, u, v in quads])
    weight = area * np.where(np.arange(len(quads)) < 5, 1.0, 2.0)
    numbers = rng.multinomial(count, weight / weight.sum())
    which = np.repeat(np.arange(len(quads)), numbers)
    origin, u, v = (np.array([quad[i] for quad in quads])[which] for i in range(3))
    means = origin + rng.random((count, 1)) * u + rng.random((count, 1)) * v
    normal = np.cross(u, v)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    means += normal * rng.normal(0, 0.01, (count, 1))
    # The rotation that takes z to the normal, after a random turn about z.
    half = rng.uniform(0, math.pi, count)
    turn = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    lift = np.stack([1 + normal[:, 2], -normal[:, 1], normal[:, 0], 0 * half], axis=1)
    w, x, y, _ = lift.T
    c, s = turn[:, 0], turn[:, 3]
    quats = np.stack([w * c, x * c + y * s, y * c - x * s, w * s], axis=1)
    spacing = np.sqrt(area / np.maximum(numbers, 1))[which][:, None]
    shape = np.exp(rng.normal(0, 0.5, (count, 3))) * [0.75, 0.75, 0.08]
    checks = np.floor(means @ np.array([[3.1, 0.7], [-0.9, 2.7], [1.3, 2.2]])).sum(axis=1) % 2
    colour = rng.uniform(0.2, 0.8, (len(quads), 3))[which] * (0.5 + 0.6 * checks[:, None])
    colour = np.clip(colour + rng.normal(0, 0.06, (count, 3)), 0, 1)
    opacity = np.clip(rng.beta(2.0, 1.0, count), 0.02, 0.99)
    sh = rng.normal(0, 0.06, (count, (degree + 1) ** 2, 3))
    sh[:, 0] = (colour - 0.5) / 0.28209479177387814
    order = rng.permutation(count)
    return Gaussians(
        means=means[order].astype(np.float32),
        log_scales=np.log(spacing * shape)[order].astype(np.float32),
        quats=quats[order].astype(np.float32),
        opacity_logits=np.log(opacity / (1 - opacity))[order].astype(np.float32),
        sh=sh[order].astype(np.float32),
    )


def cloud(count, *, degree=3, seed=0, spread=(1.0, 2.0, 3.0), centre=(0.5, -1.0, 2.0)):
    """Return random Gaussians around a centre; no symmetry anywhere."""
    rng = np.random.default_rng(seed)
    return Gaussians(
        means=(rng.normal(size=(count, 3)) * spread + centre).astype(np.float32),
        log_scales=(rng.normal(size=(count, 3)) * 0.6 - 2.5).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        opacity_logits=(rng.normal(size=count) * 1.5).astype(np.float32),
        sh=(rng.normal(size=(count, (degree + 1) ** 2, 3)) * 0.2).astype(np.float32),
    )


def psnr(*pairs):
    """Peak signal to noise in dB over pairs of images with peak 1, pooled."""
    errors = [np.mean((np.asarray(a, np.float64) - b) ** 2) for a, b in pairs]
    return float(-10 * np.log10(max(np.mean(errors), 1e-30)))
