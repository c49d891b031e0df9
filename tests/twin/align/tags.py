"""Pictures of tags of known edge in known places, drawn by homographies alone."""

import cv2
import numpy as np

_CELL = 16  # pixels of a tag's texture for each of its 8 cells; one more around is white paper.
_FINE = 3  # samples along each side of a pixel


def texture(number):
    """Return the picture of a tag with a cell of white around, (160, 160) uint8."""
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    side = 8 * _CELL
    page = np.full((side + 2 * _CELL, side + 2 * _CELL), 255, np.uint8)
    page[_CELL:-_CELL, _CELL:-_CELL] = cv2.aruco.generateImageMarker(known, number, side)
    return page


def picture(camera, tags, rng):
    """Return what a camera sees, (H, W, 3) uint8: tags on grey, blurred by its pixels, noisy.

    Each tag is (texture, T_world_tag, edge): its middle at the frame's origin, z towards who looks.
    """
    fine = np.full((camera.height * _FINE, camera.width * _FINE), 110, np.uint8)
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # Centres at (0.5, 0.5), or at (0, 0).
    for page, T, edge in tags:
        local = camera.T_camera_world @ T
        unit = edge / (len(page) - 2 * _CELL)
        middle = len(page) / 2
        plane = np.array([[unit, 0, -unit * middle], [0, -unit, unit * middle], [0, 0, 1]])
        H = np.diag([_FINE, _FINE, 1]) @ K @ local[:3, [0, 1, 3]] @ plane
        corners = local[:3, :3] @ np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [0] * 4]) * edge
        if (corners[2] + local[2, 3]).min() < 0.1 or local[:3, 2] @ local[:3, 3] > 0:
            continue  # Behind the camera, or seen from behind.
        H = np.linalg.inv(half) @ H @ half
        size = fine.shape[::-1]
        over = cv2.warpPerspective(page, H, size, flags=cv2.INTER_LINEAR)
        inside = cv2.warpPerspective(np.full_like(page, 255), H, size, flags=cv2.INTER_LINEAR)
        fine = np.where(inside > 127, over, fine)
    grey = cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    grey = 25 + 0.75 * grey + rng.normal(0, 2.0, grey.shape)
    return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
