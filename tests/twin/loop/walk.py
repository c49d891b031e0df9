"""How somebody walks a course with a phone: over it, and once around it."""

import numpy as np

from nw_scenes.rays import RayScene
from nw_splat.camera import Camera, look_at

EYE = 1.5
"""Height of the phone above the ground, metres."""
_UP = np.array([0.0, 0.0, EYE])
LOW_EYE = 0.45
"""Height of a phone that is held where a robot's head is, metres."""
FOCAL_35MM = 26
"""What EXIF says of a phone's main camera; its film is 36 mm wide."""
_BEFORE, _BEYOND = 1.3, 0.8
"""How far the walk begins before the start and ends behind the last waypoint, metres."""
_ASIDE = 1.3
"""How far one walks beside the course, metres."""
_MIDDLE = 0.4
"""Share by which one who walks around looks along with it, not at its middle."""
_ROOM = 0.45
"""That is kept to walls and furniture, metres."""
_DOWN, _LEVEL = np.radians(32.0), np.radians(8.0)
"""By turns a picture of the ground and one of what lies ahead; both look down a little."""
_ROUND, _STEEP = 1.8, np.radians(38.0)
"""How far from an obstacle one walks around it, metres, and how steeply one looks down at it."""


def handheld(scene, count, *, width, height, seed=0):
    """Return the cameras of a walk in the order of their photographs.

    A third of them over the course, camera ahead; the rest once around it, camera on it. By turns
    they look at the ground and at what lies ahead. Hands shake: 3 cm, and 2 degrees about each
    axis.

    Args:
        scene: to walk in; cameras keep clear of its mesh.
        count: of photographs.
        width, height: of each, pixels.
        seed: of the hands.
    """
    rays = RayScene(scene.mesh())
    line = _line(scene, rays)
    over = count // 3
    ways = [_over(line, share) for share in np.linspace(0.0, 1.0, over)]
    ways += [
        _around(line, rays, turn)
        for turn in np.linspace(0.0, 2.0 * np.pi, count - over, endpoint=False)
    ]
    downs = [_DOWN if number % 2 == 0 else _LEVEL for number in range(count)]
    return _shaken(ways, downs, width=width, height=height, seed=seed)


def round_the_first_obstacle(scene, count, *, width, height, seed=0):
    """Return the cameras of a walk once around the first waypoint, looking at the ground there.

    Args: as of `handheld`.
    """
    rays, eye = RayScene(scene.mesh()), scene.trail[0] * (1.0, 1.0, 0.0) + _UP
    ways = []
    for turn in np.linspace(0.0, 2.0 * np.pi, count, endpoint=False):
        out = np.array([-np.cos(turn), -np.sin(turn), 0.0])
        ways.append((eye + _clear(rays, eye, out, _ROUND), -out))
    return _shaken(ways, [_STEEP] * count, width=width, height=height, seed=seed)


def low_over_the_course(scene, count, *, width, height, seed=0):
    """Return the cameras of a walk over the course with the phone at a robot's height.

    Args: as of `handheld`.
    """
    line, down = _line(scene, RayScene(scene.mesh())), np.array([0.0, 0.0, LOW_EYE - EYE])
    places = [_over(line, share) for share in np.linspace(0.1, 0.8, count)]
    ways = [(eye + down, ahead) for eye, ahead in places]
    return _shaken(ways, [_LEVEL] * count, width=width, height=height, seed=seed + 1)


def _shaken(ways, downs, *, width, height, seed):
    """Return cameras at places with level directions, by so many radians down, in shaking hands."""
    rng, focal, found = np.random.default_rng(seed), FOCAL_35MM / 36.0 * width, []
    for (place, forward), down in zip(ways, downs, strict=True):
        gaze = np.cos(down) * forward - np.array([0.0, 0.0, np.sin(down)])
        eye = place + rng.normal(0.0, 0.03, 3)
        T = look_at(eye, eye + gaze).copy()
        T[:3, :3] = T[:3, :3] @ turned(rng.normal(0.0, np.radians(2.0), 3))
        found.append(
            Camera(
                width=width,
                height=height,
                fx=focal,
                fy=focal,
                cx=width / 2,
                cy=height / 2,
                T_world_camera=T,
            )
        )
    return found


def turned(axis):
    """Return the rotation (3, 3) by a vector of radians."""
    angle = float(np.linalg.norm(axis))
    x, y, z = np.asarray(axis) / max(angle, 1e-12)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def _line(scene, rays):
    """Return points of the way over the course, metres, from before the start to beyond its end."""
    start = np.array(scene.spawn.position)
    points = np.vstack([start, scene.trail])
    yaw = scene.spawn.yaw
    first = np.array([-np.cos(yaw), -np.sin(yaw), 0.0])
    last = points[-1] - points[-2]
    last = last * (1.0, 1.0, 0.0) / np.linalg.norm(last[:2])
    before = start + _clear(rays, start + _UP, first, _BEFORE)
    beyond = points[-1] + _clear(rays, points[-1] + _UP, last, _BEYOND)
    return np.vstack([before, points, beyond])


def _at(line, share):
    """Return the place at a share of a polyline's length, and the directions ahead and left."""
    steps = np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    place = np.array([np.interp(share * along[-1], along, axis) for axis in line.T])
    leg = int(np.clip(np.searchsorted(along, share * along[-1]) - 1, 0, len(steps) - 1))
    ahead = np.append((line[leg + 1] - line[leg])[:2] / steps[leg], 0.0)
    return place, ahead, np.array([-ahead[1], ahead[0], 0.0])


def _over(line, share):
    """Return eye and level direction of one who walks over the course."""
    place, ahead, _ = _at(line, share)
    return place + _UP, ahead


def _around(line, rays, turn):
    """Return eye and level direction of one who walks around the course, to its left first."""
    share = 0.5 - 0.5 * np.cos(turn)
    place, _, left = _at(line, share)
    eye = place + _UP
    eye = eye + _clear(rays, eye, np.sign(np.sin(turn)) * left, _ASIDE * abs(np.sin(turn)))
    target, _, _ = _at(line, 0.5 + _MIDDLE * (share - 0.5))
    forward = (target - eye) * (1.0, 1.0, 0.0)
    return eye, forward / np.linalg.norm(forward)


def _clear(rays, eye, direction, wanted):
    """Return the step from an eye in a direction: as long as wanted, or as there is room for."""
    if wanted == 0.0:
        return np.zeros(3)
    free = float(rays.distance(eye[None], direction[None])[0]) - _ROOM
    return direction * min(wanted, max(free, 0.0))
