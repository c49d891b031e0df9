"""What a robot's camera sees in a twin and in its vertex-coloured mesh, against the original."""

from dataclasses import dataclass, replace

import numpy as np
from surface import rays_of

from nw_scenes.rays import RayScene
from nw_splat.camera import Camera, look_at
from nw_splat.render import CpuRenderer
from nw_splat.store import open_store

_WIDTH, _HEIGHT, _FOVY = 240, 135, np.radians(60.0)
_EYE, _DOWN = 0.35, np.radians(5.0)
"""Height of a standing robot's head camera over the ground, metres, and how far it looks down."""


@dataclass(frozen=True, kw_only=True)
class LookFigures:
    """PSNR in dB, means over views from robot height, exposures allowed for.

    Attributes:
        splat: of the twin's splat.
        mesh: of its mesh in the colours of its vertices.
    """

    splat: float
    mesh: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """One view, (H, W, 3) float32 each."""

    original: np.ndarray
    splat: np.ndarray
    mesh: np.ndarray


def robot_cameras(line, count=12, seed=0):
    """Return cameras at a robot's height along spawn and trail (K, 3), metres."""
    rng = np.random.default_rng(seed)
    steps = np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    found = []
    for at in np.linspace(0.25, along[-1] - 0.4, count):
        leg = int(np.clip(np.searchsorted(along, at) - 1, 0, len(steps) - 1))
        place = np.array([np.interp(at, along, axis) for axis in line.T])
        yaw = np.arctan2(*(line[leg + 1] - line[leg])[1::-1]) + rng.normal(0.0, 0.15)
        gaze = np.array([np.cos(yaw), np.sin(yaw), -np.tan(_DOWN)])
        eye = place + np.array([0.0, rng.normal(0.0, 0.1), _EYE + rng.normal(0.0, 0.03)])
        T = look_at(eye, eye + gaze)
        camera = Camera.from_fovy(width=_WIDTH, height=_HEIGHT, fovy=_FOVY, T_world_camera=T)
        found.append(camera)
    return found


def looks(original, twin, mesh, T_twin_original, cameras):
    """Return the views of the original's cameras, there and in a twin.

    Args:
        original, twin: scenes.
        mesh: the twin's, with colours, in the capture's frame.
        T_twin_original: similarity.
        cameras: in the original's frame.
    """
    there, here = (
        CpuRenderer(store, projection=store.projection or "ray")
        for store in (open_store(scene.splat_store()) for scene in (original, twin))
    )
    T_splat_original = np.linalg.inv(twin.T_world_splat) @ T_twin_original
    T_splat_world = np.linalg.inv(original.T_world_splat)  # Gaps' splats lie a platform lower.
    drawn = MeshRenderer(mesh)
    found = []
    for camera in cameras:
        moved = replace(camera, T_world_camera=T_splat_original @ camera.T_world_camera)
        found.append(
            Look(
                original=there.render(
                    replace(camera, T_world_camera=T_splat_world @ camera.T_world_camera)
                ).rgb,
                splat=here.render(moved).rgb,
                mesh=drawn.render(moved),
            )
        )
    return found


def look_figures(views):
    """Return the mean PSNR of some looks."""
    return LookFigures(
        splat=float(np.mean([psnr(view.splat, view.original) for view in views])),
        mesh=float(np.mean([psnr(view.mesh, view.original) for view in views])),
    )


def psnr(picture, wanted):
    """Return dB after the affine map of colours that fits best; pictures (H, W, 3)."""
    colours = np.clip(picture, 0.0, 1.0).reshape(-1, 3).astype(np.float64)
    target = np.clip(wanted, 0.0, 1.0).reshape(-1, 3).astype(np.float64)
    basis = np.column_stack([colours, np.ones(len(colours))])
    fitted = basis @ np.linalg.lstsq(basis, target, rcond=None)[0]
    return float(-10.0 * np.log10(np.mean((fitted - target) ** 2)))


class MeshRenderer:
    """Shows a mesh in the colours of its vertices; white where there is none, as a splat's."""

    def __init__(self, mesh):
        from nw_twin.place import moved_mesh

        self._mesh = mesh
        self._rays = RayScene(moved_mesh(np.eye(4), mesh.vertices, mesh.faces))

    def render(self, camera):
        """Return (H, W, 3) float32 with four rays a pixel."""
        camera = replace(
            camera,
            width=2 * camera.width,
            height=2 * camera.height,
            **{name: 2 * getattr(camera, name) for name in ("fx", "fy", "cx", "cy")},
        )
        directions, _ = rays_of(camera)
        shape = directions.shape
        directions = directions.reshape(-1, 3)
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        eye = np.broadcast_to(camera.T_world_camera[:3, 3], directions.shape)
        distance, face = self._rays.cast(eye, directions)
        rgb = np.ones((len(face), 3))
        hit = np.flatnonzero(face >= 0)
        a, b, c = np.moveaxis(self._mesh.vertices[self._mesh.faces[face[hit]]], 1, 0)
        point = eye[hit] + distance[hit, None] * directions[hit]
        normal = np.cross(b - a, c - a)
        area = np.maximum((normal**2).sum(axis=1), 1e-30)
        u = (np.cross(c - b, point - b) * normal).sum(axis=1) / area
        v = (np.cross(a - c, point - c) * normal).sum(axis=1) / area
        weights = np.stack([u, v, 1.0 - u - v], axis=1).clip(0.0, 1.0)
        colours = self._mesh.colours[self._mesh.faces[face[hit]]] / 255.0
        rgb[hit] = (weights[:, :, None] * colours).sum(axis=1)
        height, width = shape[0] // 2, shape[1] // 2
        rgb = rgb.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
        return rgb.astype(np.float32)
