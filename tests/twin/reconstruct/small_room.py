"""A room with steps whose every distance is known, photographed: numpy alone, no engine of ours."""

from dataclasses import dataclass

import numpy as np
from PIL import Image
from twin_parts import captured, placed

from nw_splat.camera import Camera, look_at
from nw_twin.capture import write_capture
from nw_twin.options import DepthOptions, ReconstructOptions

SMALL = ReconstructOptions(
    depth=DepthOptions(side=176, neighbours=3, rounds=1), voxel=0.03, faces=20_000
)
"""For its small pictures; nightly tests have the default's neighbours and rounds."""

FLOOR_X, FLOOR_Y, HIGH = 4.0, 3.0, 1.6
"""Metres; the room has two walls and is open to the other sides and above."""

STEPS = ((2.5, 0.6, 3.4, 2.0, 0.16), (2.85, 0.6, 3.4, 2.0, 0.32), (0.9, 1.9, 1.4, 2.4, 0.25))
"""Two steps of a stair and a box: x, y of two corners, and the height; metres."""


@dataclass(frozen=True)
class Sheet:
    """A rectangle: corner + u * first + v * second, both of 0..1; its texture has a seed."""

    corner: np.ndarray
    first: np.ndarray
    second: np.ndarray
    texture: np.ndarray

    @property
    def normal(self):
        normal = np.cross(self.first, self.second)
        return normal / np.linalg.norm(normal)


def _noise(seed, across=256):
    """Noise of many octaves, (across, across, 3), mean 0.5: something to match at any size."""
    rng = np.random.default_rng(seed)
    total = np.zeros((across, across, 3))
    for octave in range(2, 9):
        cells = 2**octave
        coarse = rng.normal(size=(cells, cells, 3)) * [1.0, 0.9, 0.8]
        places = (np.arange(across) + 0.5) * cells / across - 0.5
        low = np.floor(places).astype(int)
        share = (places - low)[:, None]
        rows = (
            coarse[low % cells] * (1 - share[..., None])
            + coarse[(low + 1) % cells] * share[..., None]
        )
        total += (
            rows[:, low % cells] * (1 - share[None]) + rows[:, (low + 1) % cells] * share[None]
        ) * 0.8**octave
    return np.clip(0.5 + 0.22 * total / total.std(), 0.02, 0.98)


def _sheets():
    made_of = [
        ([0, 0, 0], [FLOOR_X, 0, 0], [0, FLOOR_Y, 0]),
        ([0, FLOOR_Y, 0], [FLOOR_X, 0, 0], [0, 0, HIGH]),
        ([FLOOR_X, 0, 0], [0, FLOOR_Y, 0], [0, 0, HIGH]),
    ]
    for x0, y0, x1, y1, z in STEPS:
        dx, dy = x1 - x0, y1 - y0
        made_of += [
            ([x0, y0, z], [dx, 0, 0], [0, dy, 0]),
            ([x0, y0, 0], [dx, 0, 0], [0, 0, z]),
            ([x0, y1, 0], [dx, 0, 0], [0, 0, z]),
            ([x0, y0, 0], [0, dy, 0], [0, 0, z]),
            ([x1, y0, 0], [0, dy, 0], [0, 0, z]),
        ]
    return [
        Sheet(*(np.array(part, float) for part in parts), _noise(seed))
        for seed, parts in enumerate(made_of)
    ]


SHEETS = _sheets()
_TEXEL = 0.012
"""Metres of one cell of a texture."""


def cast(origin, directions):
    """Return the distance to the nearest sheet along rays, and which; inf and -1 for none."""
    best, which = np.full(len(directions), np.inf), np.full(len(directions), -1)
    for number, sheet in enumerate(SHEETS):
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (sheet.corner - origin) @ sheet.normal / (directions @ sheet.normal)
            at = origin + along[:, None] * directions - sheet.corner
            u = at @ sheet.first / (sheet.first @ sheet.first)
            v = at @ sheet.second / (sheet.second @ sheet.second)
            hit = (along > 1e-6) & (along < best) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        best[hit], which[hit] = along[hit], number
    return best, which


def _colours(points, which):
    shown = np.full((len(points), 3), 0.5)
    for number, sheet in enumerate(SHEETS):
        rows = np.flatnonzero(which == number)
        at = points[rows] - sheet.corner
        places = np.stack([at @ (e / np.linalg.norm(e)) for e in (sheet.first, sheet.second)], 1)
        places /= _TEXEL
        low = np.floor(places).astype(int)
        share = (places - low)[..., None]
        n = len(sheet.texture)
        for i in range(2):
            for j in range(2):
                weight = (share[:, 0] if i else 1 - share[:, 0]) * (
                    share[:, 1] if j else 1 - share[:, 1]
                )
                part = sheet.texture[(low[:, 0] + i) % n, (low[:, 1] + j) % n] * weight
                shown[rows] = part if i == j == 0 else shown[rows] + part
    return shown


def _rays(camera, *, fine=1):
    """Directions with 1 along the optical axis, fine * fine through each pixel."""
    u = (np.arange(camera.width * fine) + 0.5) / fine
    v = (np.arange(camera.height * fine) + 0.5) / fine
    x, y = np.meshgrid((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    return rays @ camera.T_world_camera[:3, :3].T


def depth_of_room(camera):
    """Exact depth along the optical axis, (H, W); inf where there is nothing."""
    depth, _ = cast(camera.T_world_camera[:3, 3], _rays(camera))
    return depth.reshape(camera.height, camera.width)


def picture(camera, fine=2):
    """What a camera sees, (H, W, 3) uint8; each pixel is the mean of fine * fine rays."""
    eye, rays = camera.T_world_camera[:3, 3], _rays(camera, fine=fine)
    depth, which = cast(eye, rays)
    points = eye + np.where(np.isfinite(depth), depth, 0.0)[:, None] * rays
    shown = _colours(points, which).reshape(camera.height, fine, camera.width, fine, 3)
    return np.round(255 * shown.mean(axis=(1, 3))).astype(np.uint8)


def cameras(count, width, height):
    """Cameras on a bow about the room, at two heights, all looking at its middle."""
    found = []
    for n in range(count):
        turn = np.deg2rad(150 + 150 * (n // 2 + 0.5) / ((count + 1) // 2))
        eye = np.array([2.2 + 2.6 * np.cos(turn), 1.5 + 2.2 * np.sin(turn), 0.9 + 0.7 * (n % 2)])
        target = np.array([2.3, 1.6, 0.1]) + 0.25 * np.array([np.sin(7.0 * n), np.cos(5.0 * n), 0])
        found.append(
            Camera.from_fovy(
                width=width, height=height, fovy=1.0, T_world_camera=look_at(eye, target)
            )
        )
    return found


def spread(step, seed=0):
    """Points all over the room's sheets, one in each `step` * `step` metres; and whose each is."""
    rng, points, whose = np.random.default_rng(seed), [], []
    for number, sheet in enumerate(SHEETS):
        across = [np.linalg.norm(e) for e in (sheet.first, sheet.second)]
        count = max(1, int(across[0] * across[1] / step**2))
        u, v = rng.uniform(size=(2, count, 1))
        points.append(sheet.corner + u * sheet.first + v * sheet.second)
        whose.append(np.full(count, number))
    return np.concatenate(points), np.concatenate(whose)


def is_seen(points, camera):
    """Whether a camera sees each point."""
    eye = camera.T_world_camera[:3, 3]
    local = (points - eye) @ camera.T_world_camera[:3, :3]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = camera.fx * local[:, 0] / local[:, 2] + camera.cx
        v = camera.fy * local[:, 1] / local[:, 2] + camera.cy
    shown = (local[:, 2] > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    rows = np.flatnonzero(shown)
    reach, _ = cast(eye, points[rows] - eye)
    shown[rows] = reach > 1.0 - 1e-6
    return shown


def distance_to_room(points):
    """Exact distance of each point to the nearest sheet, metres."""
    nearest = np.full(len(points), np.inf)
    for sheet in SHEETS:
        at = points - sheet.corner
        u = np.clip(at @ sheet.first / (sheet.first @ sheet.first), 0, 1)[:, None]
        v = np.clip(at @ sheet.second / (sheet.second @ sheet.second), 0, 1)[:, None]
        gap = np.linalg.norm(at - u * sheet.first - v * sheet.second, axis=1)
        nearest = np.minimum(nearest, gap)
    return nearest


def write_room(folder, count=10, width=224, height=126):
    """Photograph the room into a capture's folder and return the capture."""
    points, _ = spread(0.08, seed=1)
    views = cameras(count, width, height)
    seen = np.array([is_seen(points, camera) for camera in views])
    kept = seen.sum(axis=0) >= 2
    points, seen = points[kept], seen[:, kept]
    points += np.random.default_rng(2).normal(0, 0.002, points.shape)
    (folder / "pictures").mkdir(parents=True)
    shots = []
    for n, camera in enumerate(views):
        file = f"pictures/{n:02d}.png"
        Image.fromarray(picture(camera)).save(folder / file)
        shots.append(placed(f"{n:02d}.jpg", camera, np.flatnonzero(seen[n]), file=file))
    capture = captured(shots, points)
    write_capture(capture, folder)
    return capture
