"""Photographs of a scene as a phone takes them: exposures that change, blur, noise, JPEG."""

from dataclasses import replace

import cv2
import numpy as np
from PIL import Image
from walk import FOCAL_35MM, turned

from nw_scenes.rays import RayScene
from nw_splat.image import composite
from nw_splat.render import CpuRenderer
from nw_splat.store import open_store

TAG_EDGE = 0.24
"""Outer edge of the tag's black border: on A3 paper, metres."""
_THICK = 0.03
"""Of the Gaussians of a floor, along a ray at most, metres."""
_BLURRED = 3
"""Moments of an exposure."""


class Phone:
    """Takes photographs of a scene in which a printed tag lies.

    Args:
        scene: built in.
        tag: (4, 4) T_world_tag: the tag's middle, x and y along the paper; None = there is none.
        seed: of exposures, hands and noise.
    """

    def __init__(self, scene, tag=None, seed=0):
        store = open_store(scene.splat_store())
        self._renderer = CpuRenderer(store, projection="ray", threads=2)
        self._T_splat_world = np.linalg.inv(scene.T_world_splat)
        self._tag, self._paper = tag, _paper()
        self._seed = seed

    def photograph(self, camera, number):
        """Return (H, W, 3) uint8, the same for the same number."""
        rng = np.random.default_rng((self._seed, number))
        shake, drift = np.radians(rng.normal(0.0, 0.05, 3)), rng.normal(0.0, 0.001, 3)
        moments = []
        for share in np.linspace(-1.0, 1.0, _BLURRED):
            T = camera.T_world_camera.copy()
            T[:3, :3] = T[:3, :3] @ turned(share * shake)
            T[:3, 3] += share * drift
            moments.append(self.sharp(replace(camera, T_world_camera=T)))
        light = np.mean(moments, axis=0) * np.exp(rng.normal(0.0, 0.08))
        light = light * np.exp(rng.normal(0.0, 0.015, 3))
        noise = rng.normal(0.0, 1.0, light.shape) * (0.004 + 0.012 * np.sqrt(np.clip(light, 0, 1)))
        return np.round(255.0 * np.clip(light + noise, 0.0, 1.0)).astype(np.uint8)

    def sharp(self, camera):
        """Return (H, W, 3) float32 without any of that."""
        pose = self._T_splat_world @ camera.T_world_camera
        image = self._renderer.render(replace(camera, T_world_camera=pose))
        if self._tag is None:
            return image.rgb
        return composite(image, *_drawn(self._paper, self._tag, camera)).rgb


def tag_beside_start(scene):
    """Return T_world_tag (4, 4): on the ground beside the start, where no robot looks from there.

    Raises:
        LookupError: the ground is nowhere flat enough.
    """
    x, y, z = scene.spawn.position
    cos, sin = np.cos(scene.spawn.yaw), np.sin(scene.spawn.yaw)
    half = TAG_EDGE * 0.63
    corners = np.array([[a, b] for a in (-half, half) for b in (-half, half)])
    rays = RayScene(scene.mesh())
    for aside in (0.45, -0.45, 0.3, -0.3, 0.0):
        middle = np.array([x - sin * aside, y + cos * aside])
        heights = rays.height(middle + corners, z_from=z + 1.0)
        if np.ptp(heights) < 0.003:
            T = np.eye(4)
            T[:2, :2] = [[cos, -sin], [sin, cos]]
            T[:3, 3] = [*middle, heights.mean() + 0.003]
            return T
    raise LookupError(f"{scene.name}: no flat ground for a tag beside the start")


def write_photograph(path, picture):
    """Write a JPEG with the focal length that a phone writes."""
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = FOCAL_35MM  # FocalLengthIn35mmFilm
    exif[0x010F] = "none"
    Image.fromarray(picture).save(path, quality=93, subsampling=0, exif=exif)


def _paper():
    """Return the picture (H, W) float32 of the paper: an AprilTag 36h11 with a white border."""
    marks = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    tag = cv2.aruco.generateImageMarker(marks, 7, 640, borderBits=1)
    tag = cv2.copyMakeBorder(tag, 80, 80, 80, 80, cv2.BORDER_CONSTANT, value=255)
    return 0.05 + 0.85 * tag.astype(np.float32) / 255.0


def _drawn(paper, T_world_tag, camera):
    """Return rgb, depth and coverage of the paper in a camera's picture."""
    side = TAG_EDGE * 1.25
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * side / 2
    flat = np.column_stack([corners, np.zeros(4), np.ones(4)])
    local = flat @ (camera.T_camera_world @ T_world_tag).T
    shape = (camera.height, camera.width)
    rgb, depth = np.zeros((*shape, 3), np.float32), np.full(shape, np.inf, np.float32)
    if (local[:, 2] < 0.1).any():
        return rgb, depth, np.zeros(shape, np.float32)
    seen = local[:, :2] / local[:, 2:3] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    # Four by four samples of each pixel; pixel centres lie at halves, OpenCV's at whole numbers.
    fine = 4
    at = (seen * fine - 0.5).astype(np.float32)
    n = len(paper)
    source = np.array([[0, 0], [n, 0], [n, n], [0, n]], np.float32) - 0.5
    H = cv2.getPerspectiveTransform(source, at)
    size = (shape[1] * fine, shape[0] * fine)
    grey = cv2.warpPerspective(paper, H, size, flags=cv2.INTER_AREA)
    inside = cv2.warpPerspective(np.ones_like(paper), H, size, flags=cv2.INTER_NEAREST)
    down = (shape[1], shape[0])
    coverage = cv2.resize(inside, down, interpolation=cv2.INTER_AREA)
    grey = cv2.resize(grey * inside, down, interpolation=cv2.INTER_AREA)
    rgb[:] = (grey / np.maximum(coverage, 1e-6))[..., None]
    # Depth of the paper's plane along each pixel's ray; Gaussians have a thickness, below which
    # none is to hide it.
    T = camera.T_camera_world @ T_world_tag
    x, y = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(shape)], -1)
    facing = rays @ T[:3, 2]
    plane = float(T[:3, 3] @ T[:3, 2]) / np.where(np.abs(facing) > 1e-9, facing, 1e-9)
    depth = np.where((coverage > 0) & (plane > 0), plane - _THICK, np.inf).astype(np.float32)
    return rgb, depth, np.clip(coverage, 0.0, 1.0)
