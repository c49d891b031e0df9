"""A room that is known exactly, and photographs of it without any OpenGL.

Four by three metres, two boxes on the floor; each flat patch is painted with noise of several
octaves, so that features can be found on it. Pictures and depth come by casting rays.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from nw_splat.camera import Camera, look_at

TEXEL = 0.01
"""Metres of one texel of a patch."""


@dataclass(frozen=True)
class Patch:
    """A painted parallelogram: `corner + a * along + b * down` for a, b in 0..1, metres."""

    corner: np.ndarray
    along: np.ndarray
    down: np.ndarray
    texture: np.ndarray  # (rows along `down`, columns along `along`, 3) float32, 0..255.


def noise(rng, rows, columns, *, octaves=(2, 4, 8, 16, 32)):
    """Return (rows, columns, 3) float32 of coloured noise, cells of so many texels."""
    total = np.zeros((rows, columns, 3), np.float32)
    for cell in octaves:
        grid = rng.normal(size=(rows // cell + 3, columns // cell + 3, 3)).astype(np.float32)
        grid += 1.5 * grid.mean(axis=2, keepdims=True)  # Mostly brightness: features are grey.
        size = (grid.shape[1] * cell, grid.shape[0] * cell)
        shift = rng.integers(0, cell, 2)
        large = cv2.resize(grid, size, interpolation=cv2.INTER_CUBIC)[shift[0] :, shift[1] :]
        total += large[:rows, :columns]
    return np.clip(128 + 13 * total, 0, 255)


def patch(rng, corner, along, down, *, picture=None):
    """Return a patch with noise; with a picture (h, w) or (h, w, 3) uint8, that instead."""
    corner, along, down = (np.asarray(v, dtype=np.float64) for v in (corner, along, down))
    columns, rows = (max(4, round(float(np.linalg.norm(v)) / TEXEL)) for v in (along, down))
    texture = noise(rng, rows, columns)
    if picture is not None:
        texture = np.asarray(picture, dtype=np.float32)
        texture = np.repeat(texture[..., None], 3, axis=2) if texture.ndim == 2 else texture
    return Patch(corner, along, down, texture)


def box(rng, low, high):
    """Return the five patches of a box that can be seen: not its bottom."""
    (x, y, z), (X, Y, Z) = low, high
    w, d, h = X - x, Y - y, Z - z
    return [
        patch(rng, (x, y, Z), (w, 0, 0), (0, d, 0)),
        patch(rng, (x, y, Z), (w, 0, 0), (0, 0, -h)),
        patch(rng, (x, Y, Z), (w, 0, 0), (0, 0, -h)),
        patch(rng, (x, y, Z), (0, d, 0), (0, 0, -h)),
        patch(rng, (X, y, Z), (0, d, 0), (0, 0, -h)),
    ]


def room(seed=0, *, tag=None, tag_edge=0.3):
    """Return the patches of the room: floor z = 0, x in -2..2, y in -1.5..1.5, walls 2 m high.

    Args:
        seed: of the paint.
        tag: a picture, such as an AprilTag with its white border, that lies 2 mm over the floor
            round (0.3, 0.3), its first row towards +y.
        tag_edge: metres of the whole picture's side.
    """
    rng = np.random.default_rng(seed)
    found = [
        patch(rng, (-2, -1.5, 0), (4, 0, 0), (0, 3, 0)),
        patch(rng, (-2, 1.5, 2), (4, 0, 0), (0, 0, -2)),
        patch(rng, (-2, -1.5, 2), (4, 0, 0), (0, 0, -2)),
        patch(rng, (-2, -1.5, 2), (0, 3, 0), (0, 0, -2)),
        patch(rng, (2, -1.5, 2), (0, 3, 0), (0, 0, -2)),
        *box(rng, (-0.9, -0.2, 0), (-0.4, 0.4, 0.35)),
        *box(rng, (0.5, -0.6, 0), (0.9, -0.2, 0.6)),
    ]
    if tag is not None:
        e = tag_edge
        corner = (0.3 - e / 2, 0.3 + e / 2, 0.002)
        found.append(patch(rng, corner, (e, 0, 0), (0, -e, 0), picture=tag))
    return found


def cameras(count=12, *, width=320, height=180, fovy=0.85, turn=2.4, seed=0):
    """Return cameras on an arc inside the room, a hand's unsteadiness off it, that look across."""
    rng = np.random.default_rng(seed)
    found = []
    for angle in np.linspace(-np.pi / 2 - turn / 2, -np.pi / 2 + turn / 2, count):
        eye = np.array([1.7 * np.cos(angle), 1.25 * np.sin(angle), 1.2]) + rng.normal(0, 0.05, 3)
        target = np.array([0.0, 0.35, 0.35]) + rng.normal(0, 0.05, 3)
        T = look_at(eye, target)
        found.append(Camera.from_fovy(width=width, height=height, fovy=fovy, T_world_camera=T))
    return found


def render(patches, camera, *, radial=0.0, samples=2):
    """Return a photograph (H, W, 3) uint8; black where nothing is.

    Args:
        patches: what there is.
        camera: pinhole; the lens bends what it sees by `radial`.
        radial: k of COLMAP's SIMPLE_RADIAL: seen at p (1 + k |p|^2) where a pinhole sees p.
        samples: rays along each side of a pixel.
    """
    rgb, _ = _cast(patches, camera, radial, samples)
    rgb = rgb.reshape(camera.height, samples, camera.width, samples, 3).mean(axis=(1, 3))
    return np.round(rgb).astype(np.uint8)


def depth_of(patches, camera, *, radial=0.0):
    """Return depth (H, W) float32 along the axis at the pixels' centres, metres; 0 for nothing."""
    return _cast(patches, camera, radial, 1)[1].reshape(camera.height, camera.width)


def _cast(patches, camera, radial, n):
    """Return the colour and the depth of n x n rays a pixel, row by row."""
    x, y = np.meshgrid(
        (np.arange(camera.width * n) + 0.5) / n, (np.arange(camera.height * n) + 0.5) / n
    )
    bent = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy], axis=-1)
    straight = bent
    for _ in range(20 if radial else 0):
        straight = bent / (1 + radial * (straight**2).sum(axis=-1, keepdims=True))
    T = camera.T_world_camera
    rays = np.concatenate([straight, np.ones((*x.shape, 1))], axis=-1).reshape(-1, 3)
    rays = (rays @ T[:3, :3].T).astype(np.float32)
    near = np.full(len(rays), np.inf, np.float32)
    rgb = np.zeros((len(rays), 3), np.float32)
    for one in patches:
        normal = np.cross(one.along, one.down)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = float((one.corner - T[:3, 3]) @ normal) / (rays @ normal.astype(np.float32))
        rows = np.flatnonzero((depth > 1e-6) & (depth < near))
        edges = np.stack([v / (v @ v) for v in (one.along, one.down)], axis=1)
        at = depth[rows, None] * (rays[rows] @ edges.astype(np.float32))
        a, b = (at + ((T[:3, 3] - one.corner) @ edges).astype(np.float32)).T
        inside = (a >= 0) & (a < 1) & (b >= 0) & (b < 1)
        rows, a, b = rows[inside], a[inside], b[inside]
        near[rows] = depth[rows]
        if len(rows):
            size = one.texture.shape
            u, v = (a * size[1] - 0.5).astype(np.float32), (b * size[0] - 0.5).astype(np.float32)
            rgb[rows] = _sample(one.texture, u, v)
    near[~np.isfinite(near)] = 0
    return rgb, near.astype(np.float32)


def _sample(texture, u, v):
    """Bilinear samples; (row, column) pairs are laid out so that cv2's size limit is not met."""
    width = 8192
    rows = -(-len(u) // width)
    padding = rows * width - len(u)
    maps = [np.pad(m, (0, padding)).reshape(rows, width) for m in (u, v)]
    texture = texture.astype(np.float32)
    found = cv2.remap(texture, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found.reshape(-1, 3)[: len(u)]
