"""A yard with a painted splat, a door of triangles on a hinge, and a crate of Gaussians."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nw_splat.files.ply import write_threedgs_ply
from nw_splat.gaussians import SH0, Gaussians

SCENE = """\
nw-scene: 1
name: yard/props
task: open
licence: MIT
trail: [[4.0, 0.0, 0.0]]
spawn: {x_jitter: 0.0, y_jitter: 0.0, yaw_jitter: 0.0}
splat: yard.ply
props:
  - name: door
    mesh: door.obj
    color: [0.2, 0.35, 0.7]
    position: [2.4, 0.5, 0.0]
    mass: 8.0
    joint: {type: hinge, axis: [0, 0, 1], range: [-1.5, 1.5], damping: 0.4}
  - name: crate
    splat: crate.ply
    boxes: [{half_size: [0.15, 0.15, 0.15]}]
    position: [1.4, -0.3, 0.15]
    mass: 1.5
"""
COLLISION = """\
boxes:
  - {center: [3.5, 0.0, 0.5], half_size: [0.1, 2.0, 0.5], kind: structure}
  - {center: [1.9, 0.9, 0.25], half_size: [0.15, 0.25, 0.25]}
"""
DOOR = (-0.02, 0.02), (-0.9, 0.0), (0.02, 0.8)
"""Of the door's leaf along x, y and z of its own frame, m: the hinge is at its left edge."""


def write_scene(folder: Path) -> Path:
    """Write the scene's folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.yaml").write_text(SCENE, encoding="utf-8")
    (folder / "collision.yaml").write_text(COLLISION, encoding="utf-8")
    corners = [(x, y, z) for x in DOOR[0] for y in DOOR[1] for z in DOOR[2]]
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {face}" for face in faces]
    (folder / "door.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    ground = _sheet((-1, -2.5, 0), (5, 0, 0), (0, 5, 0), (0.45, 0.5, 0.4), (0.55, 0.58, 0.5))
    wall = _box((3.5, 0, 0.5), (0.1, 2.0, 0.5), (0.7, 0.68, 0.62), (0.6, 0.58, 0.52))
    block = _box((1.9, 0.9, 0.25), (0.15, 0.25, 0.25), (0.75, 0.3, 0.25), (0.65, 0.25, 0.2))
    write_threedgs_ply(folder / "yard.ply", _gaussians([ground, *wall, *block]))
    crate = _box((0, 0, 0), (0.15, 0.15, 0.15), (0.62, 0.45, 0.25), (0.45, 0.3, 0.15))
    write_threedgs_ply(folder / "crate.ply", _gaussians(crate))
    return folder


def _sheet(origin, u, v, one, two, step=0.02):
    """Return centres (N, 3) and colours (N, 3) of a chequered parallelogram."""
    origin, u, v = (np.array(part, float) for part in (origin, u, v))
    a = np.arange(step / 2, np.linalg.norm(u), step) / np.linalg.norm(u)
    b = np.arange(step / 2, np.linalg.norm(v), step) / np.linalg.norm(v)
    s, t = (part.ravel() for part in np.meshgrid(a, b))
    points = origin + s[:, None] * u + t[:, None] * v
    dark = (np.floor(s * np.linalg.norm(u) * 5) + np.floor(t * np.linalg.norm(v) * 5)) % 2 > 0
    return points, np.where(dark[:, None], one, two)


def _box(center, half, one, two):
    """Return sheets that are the faces of a box."""
    center, half = np.array(center, float), np.array(half, float)
    sheets = []
    for axis in range(3):
        u, v = np.zeros(3), np.zeros(3)
        u[(axis + 1) % 3], v[(axis + 2) % 3] = 2 * half[(axis + 1) % 3], 2 * half[(axis + 2) % 3]
        for side in (-1, 1):
            corner = center - half
            corner[axis] = center[axis] + side * half[axis]
            sheets.append(_sheet(corner, u, v, one, two))
    return sheets


def _gaussians(sheets) -> Gaussians:
    points = np.concatenate([points for points, _ in sheets])
    colours = np.concatenate([colours for _, colours in sheets])
    count = len(points)
    return Gaussians(
        means=points,
        log_scales=np.full((count, 3), np.log(0.012)),
        quats=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        opacity_logits=np.full(count, 4.0),
        sh=((colours - 0.5) / SH0)[:, None, :],
    )
