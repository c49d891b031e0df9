"""Places whose up is known, as real ones are: sloping, slanted, bent, and badly photographed."""

import math

import cv2
import numpy as np
from PIL import Image
from rooms import about_z, capture, patch, similarity

from nw_splat.camera import look_at
from nw_twin.align.alignment import AlignOptions, KnownLength


def tilted(rng, degrees):
    """Return a rotation about a level axis."""
    turn = rng.uniform(0, 2 * math.pi)
    axis = np.array([math.cos(turn), math.sin(turn), 0.0])
    return cv2.Rodrigues(math.radians(degrees) * axis)[0]


def about(points, rotation, centre):
    return (points - centre) @ rotation.T + centre


def surfaces(rng, outdoor):
    """Return points of a place of 6 m by 5 m: ground, walls, furniture, scatter."""
    centre = np.array([3.0, 2.5, 0.0])
    slope = abs(rng.normal(0, 2.5)) if outdoor else abs(rng.normal(0, 0.15))
    ground = tilted(rng, slope)
    parts = []
    if rng.random() < 0.85:
        count = int(rng.choice([40, 150, 500, 1200]))
        parts.append(about(patch(rng, count, (0, 0, 0), (6, 0, 0), (0, 5, 0)), ground, centre))
    for origin, along in (((0, 0, 0), (6, 0, 0)), ((0, 0, 0), (0, 5, 0)), ((6, 0, 0), (0, 5, 0))):
        if rng.random() < (0.4 if outdoor else 0.7):
            wall = patch(rng, int(rng.choice([60, 200, 500])), origin, along, (0, 0, 2.6))
            parts.append(about(wall, tilted(rng, abs(rng.normal(0, 0.6))), np.array(origin)))
    for _ in range(rng.integers(0, 4)):  # Tables are level; sofas, screens, ramps and roofs slant.
        size, low = rng.uniform(0.5, 2.0, 2), np.append(rng.uniform(0.5, 4, 2), rng.uniform(0.2, 1))
        one = patch(rng, int(rng.choice([50, 200, 600])), low, (size[0], 0, 0), (0, size[1], 0))
        slant = abs(rng.normal(0, 0.4)) if rng.random() < 0.5 else rng.uniform(5, 80)
        parts.append(about(one, tilted(rng, slant), low))
    if not outdoor and rng.random() < 0.3:
        parts.append(patch(rng, 300, (0, 0, 2.6), (6, 0, 0), (0, 5, 0)))
    parts.append(rng.uniform((0, 0, 0), (6, 5, 2.6), (int(rng.choice([60, 200, 600])), 3)))
    points = np.concatenate(parts)
    return points + rng.normal(0, rng.choice([0.004, 0.015]), points.shape)


def shots(rng):
    """Return poses of few or many photographs, by hands that roll, in common too."""
    count = int(rng.choice([4, 6, 10, 20, 40]))
    roll, common = rng.choice([1.0, 2.5, 5.0, 7.0]), rng.normal(0, 2.0)
    pitch, is_straight = rng.uniform(0, 35), rng.random() < 0.4
    poses = []
    for i in range(count):
        turn = 2 * math.pi * i / count
        eye = np.array([3 + 1.9 * math.cos(turn), 2.5 + 1.4 * math.sin(turn), rng.normal(1.5, 0.1)])
        heading = turn + rng.normal(0, 0.5) + math.pi
        if is_straight:
            eye = np.array([0.3 + 4.0 * i / count, 2.5, rng.normal(1.5, 0.05)])
            heading = rng.normal(0, 0.08)
        down = math.radians(pitch + rng.normal(0, 5))
        way = [math.cos(heading) * math.cos(down), math.sin(heading) * math.cos(down)]
        T = look_at(eye, eye + np.array([*way, -math.sin(down)]))
        T[:3, :3] = T[:3, :3] @ about_z(math.radians(common + rng.normal(0, roll)))
        poses.append(T)
    return np.array(poses)


def bent(rng, points, poses):
    """Return a map as calibration bends it: a bow by up to some degrees from end to end."""
    along = rng.normal(size=3) * (1, 1, 0.2)
    along /= np.linalg.norm(along)
    bow = math.tan(math.radians(abs(rng.normal(0, 1.0)))) / 6.0 * rng.normal(size=3) / 1.7
    place = np.array([3.0, 2.5, 1.0])
    moved = lambda x: x + (((x - place) @ along) ** 2)[..., None] * bow  # noqa: E731
    poses = poses.copy()
    poses[:, :3, 3] = moved(poses[:, :3, 3])
    return moved(points), poses


def edges(rng):
    """Return edges (E, 2, 3): upright ones, those of furniture and of a slant, and any."""
    found = []
    for _ in range(int(rng.choice([0, 5, 20, 40]))):  # Houses, doors and windows.
        foot = np.append(rng.uniform((-1, -1), (7, 6)), 0.2)
        found.append([foot, foot + tilted(rng, abs(rng.normal(0, 0.4))) @ (0, 0, 1.8)])
    slant = tilted(rng, rng.uniform(5, 25)) @ (0, 0, 1.2)
    for _ in range(int(rng.choice([0, 10, 30]))):  # Legs of chairs, beams, what leans alike.
        foot = np.append(rng.uniform((0, 0), (6, 5)), 0.2)
        found.append([foot, foot + slant])
    for _ in range(int(rng.choice([20, 60]))):
        foot = rng.uniform((0, 0, 0), (6, 5, 2.5))
        found.append([foot, foot + rng.normal(0, 0.7, 3)])
    return np.array(found)


def drawn(folder, found, lines):
    """Draw edges ((E, 2, 3), the capture's frame) into a capture's pictures."""
    for shot in found.shots:
        c = shot.camera
        picture = np.full((c.height, c.width, 3), 200, np.uint8)
        for ends in lines:
            local = ends @ c.T_camera_world[:3, :3].T + c.T_camera_world[:3, 3]
            if local[:, 2].min() > 0.2:
                pixels = local[:, :2] / local[:, 2:] * (c.fx, c.fy) + (c.cx, c.cy) - 0.5
                if np.abs(pixels).max() < 1e4:
                    a, b = ((16 * end).astype(int).tolist() for end in pixels)
                    cv2.line(picture, a, b, (30, 30, 30), 2, cv2.LINE_AA, 4)
        Image.fromarray(picture).save(folder / shot.file, compress_level=1)


def place(seed, folder):
    """Return a capture, its pictures' folder or None, T from metres, and what is true in metres.

    That is its points (N, 3) and its shots' poses (V, 4, 4).
    """
    rng = np.random.default_rng(seed)
    outdoor = rng.random() < 0.4
    points, poses = surfaces(rng, outdoor), shots(rng)
    # Edges are not bent: pictures show them through poses that are.
    true = points, poses
    points, poses = bent(rng, points, poses)
    T = similarity(rng)
    names = [f"{i}.png" for i in range(len(poses))]
    found = capture(points, poses, T, files=names, size=(320, 240))
    if rng.random() < 0.5 or folder is None:
        return found, None, T, true
    drawn(folder, found, edges(rng) @ T[:3, :3].T + T[:3, 3])
    return found, folder, T, true


LIES = (0.3048, 3.281, 0.0254, 0.8, 1.25, 0.5, 2.0, 1.1, 0.93)
"""Feet, inches, the inner or the outer edge of a tag, a diameter for a radius, a bent ruler."""


def sources(rng, found, true, lies):
    """Return options with a height, lengths and positions as people and phones know them.

    Args:
        rng: of what is given and how far it is off.
        found: the capture.
        true: its points and poses in metres.
        lies: of the sources, so many are wrong altogether.
    """
    points, poses = true
    kinds = rng.permutation(["height", "length", "length", "positions"])
    off = [rng.choice(LIES) if n < lies else 1.0 for n in range(4)]
    given = {"lengths": ()}
    for kind, lie in list(zip(kinds, off, strict=True))[: rng.integers(lies + 1, 5)]:
        if kind == "height":
            given["camera_height"] = lie * 1.5 * math.exp(rng.normal(0, 0.05))
        elif kind == "length":
            a, b = rng.integers(len(points), size=2)
            while (metres := float(np.linalg.norm(points[a] - points[b]))) < 1.0:
                a, b = rng.integers(len(points), size=2)
            ends = [tuple(found.points[end].tolist()) for end in (a, b)]
            length = lie * metres * math.exp(rng.normal(0, 0.01))
            given["lengths"] += (KnownLength(first=ends[0], second=ends[1], metres=length),)
        else:
            drift = lie * math.exp(rng.normal(0, 0.015))  # Of a phone's tracking.
            spots = drift * (poses[:, :3, 3] + rng.normal(0, 0.01, (len(poses), 3)))
            names = [shot.name for shot in found.shots]
            given["positions"] = dict(zip(names, map(tuple, spots.tolist()), strict=True))
    return AlignOptions(**given)
