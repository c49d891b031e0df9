from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from nw_places.bake.materials import is_known
from nw_places.places.crowns import crown_mesh
from nw_places.places.parts import Crown
from nw_scenes.mesh import FACE_KINDS, box_mesh, rotation_matrix
from nw_scenes.rays import RayScene
from nw_sim.catalogue import _BY_NAME, get_scene, names


@pytest.fixture(params=names())
def scene(request):
    return get_scene(request.param)


def _quads(mesh):
    """Return the corners of faces made of two triangles, (Q, 4, 3)."""
    pairs = [
        sorted(set(one) | set(two))
        for one, two in pairwise(mesh.faces.tolist())
        if len(set(one) | set(two)) == 4
    ]
    return mesh.vertices[np.array(pairs)]


def test_every_solid_has_exactly_its_faces_in_the_mesh(scene):
    quads = _quads(scene.mesh())
    middles = quads.mean(axis=1)
    for box in scene.solids:
        triangles = box_mesh(box.center, box.half_size, box.quat, box.kind).triangles
        for face in triangles.reshape(6, 6, 3):
            # A face is two triangles, split along either diagonal: its four corners count.
            corners = np.unique(np.round(face, 9), axis=0)
            here = quads[np.abs(middles - corners.mean(axis=0)).max(axis=1) < 1e-6]
            apart = np.abs(here[:, :, None] - corners[None, None]).max(axis=3).min(axis=1)
            assert len(here), box
            assert apart.max(axis=1).min() < 1e-6, box


def test_height_rays_on_obstacles_meet_their_upper_faces(scene):
    rays = RayScene(scene.mesh())
    rng = np.random.default_rng(1)
    for box in scene.solids:
        if box.kind != "obstacle":
            continue
        on_top = 1.98 * (rng.random((60, 3)) - 0.5) * np.array(box.half_size)
        on_top[:, 2] = box.half_size[2]
        points = on_top @ rotation_matrix(box.quat).T + np.array(box.center)
        above = rays.height(points[:, :2]) - points[:, 2]
        # Some of it may lie under the next step, a parapet or the edge of a deck.
        assert above.min() > -1e-6, box
        assert np.median(above) < 1e-6, box


def _slope(scene):
    """Return the steepest slope that a trail leads over: the tangent of its angle."""
    tilt = [rotation_matrix(box.quat)[2, 2] for box in scene.solids if box.kind == "obstacle"]
    return np.tan(np.arccos(min(1.0, *tilt, 1.0)))


def test_waypoints_lie_on_what_is_beneath_them_wherever_noise_moves_them(scene):
    rays = RayScene(scene.mesh())
    assert np.allclose(rays.height(scene.trail[:, :2]), scene.trail[:, 2], atol=1e-6)
    reach = 1e-6 + scene.waypoint_noise[1] * _slope(scene)
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            moved = scene.trail[:, :2] + np.array([dx, dy]) * scene.waypoint_noise
            assert np.abs(rays.height(moved) - scene.trail[:, 2]).max() < reach


def test_nothing_stands_within_half_a_metre_of_the_spawn(scene):
    rays = RayScene(scene.mesh())
    assert scene.spawn.position == (0.0, 0.0, 0.0)
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, 41), np.linspace(-0.5, 0.5, 41))
    assert np.all(rays.height(np.stack([x.ravel(), y.ravel()], axis=1)) == 0.0)
    level = np.stack([np.zeros(360), np.zeros(360), np.full(360, 0.25)], axis=1)
    angle = np.radians(np.arange(360))
    ways = np.stack([np.cos(angle), np.sin(angle), np.zeros(360)], axis=1)
    assert rays.cast(level, ways)[0].min() > 0.6


def test_the_trail_is_free_of_clutter(scene):
    rays, kinds = RayScene(scene.mesh()), scene.mesh().kinds
    corners = np.vstack([[0.0, 0.0, 0.0], scene.trail])
    for start, end in pairwise(corners):
        along = (end - start)[:2]
        length = np.hypot(*along)
        along = along / length
        across = np.array([-along[1], along[0]])
        s, t = np.meshgrid(np.arange(0.0, length + 0.4, 0.05), np.linspace(-0.45, 0.45, 19))
        xy = start[:2] + s.reshape(-1, 1) * along + t.reshape(-1, 1) * across
        down = np.tile([0.0, 0.0, -1.0], (len(xy), 1))
        # From a metre above the higher end: over a robot's back, under ceilings and crowns.
        eye = np.column_stack([xy, np.full(len(xy), max(start[2], end[2]) + 1.0)])
        _, face = rays.cast(eye, down)
        found = {FACE_KINDS[kind] for kind in np.unique(kinds[face])}
        assert found <= {"ground", "obstacle"}


def test_the_meshes_of_boxes_and_crowns_are_watertight():
    crown = Crown(center=(0, 0, 2), radii=(1, 2, 0.5), material="leaves/oak")
    box = box_mesh((1, 2, 3), (0.1, 0.2, 0.3), (0.9, 0.1, 0.2, 0.3), "obstacle")
    for mesh in (box, crown_mesh(crown)):
        edges = Counter(
            (int(a), int(b))
            for face in mesh.faces
            for a, b in zip(face, np.roll(face, -1), strict=True)
        )
        assert set(edges.values()) == {1}
        assert all((b, a) in edges for a, b in edges)
        # Closed and counter-clockwise from outside: the signed volume is positive.
        t = mesh.triangles
        assert np.einsum("ij,ij->i", t[:, 0], np.cross(t[:, 1], t[:, 2])).sum() > 0


def test_without_collisions_nothing_but_the_ground_is_left_to_touch():
    scene = get_scene("hurdles/three_low")
    ghost = scene.without_collisions()
    assert ghost.solids == ()
    assert ghost.mesh() is scene.mesh()
    assert ghost.digest != scene.digest


@pytest.mark.parametrize("name", names())
def test_every_material_that_a_place_names_is_known(name):
    place = _BY_NAME[name].place()
    used = {patch.material for patch in place.patches}
    used |= {decal.material for patch in place.patches for decal in patch.decals}
    used |= {part.material for part in (*place.crowns, *place.lawns)}
    assert {material for material in used if not is_known(material)} == set()


def test_patches_are_parallelograms_with_right_angles_unless_they_lean():
    # Textures are laid along u and across it; a very slanted patch would shear them.
    for name in names():
        for patch in _BY_NAME[name].place().patches:
            u, v = np.array(patch.u), np.array(patch.v)
            slant = abs(u @ v) / np.linalg.norm(u) / np.linalg.norm(v)
            assert slant < 0.8, (name, patch)
