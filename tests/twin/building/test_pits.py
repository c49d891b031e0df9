"""Holes of a surface that photographs look into: open beside lower ground, and closed elsewhere."""

import numpy as np
import pytest
from PIL import Image
from twin_parts import captured, grid, joined, placed, terrain

from nw_scenes.rays import RayScene
from nw_splat.camera import Camera, look_at
from nw_twin.building.pits import _dug, _Plan, with_pits
from nw_twin.capture import read_capture, write_capture
from nw_twin.reconstruct.depth import array_file, write_arrays
from nw_twin.reconstruct.surface import ColourMesh

HIGH, RIM, FAR_RIM = 0.4, 1.0, 1.3
"""Two platforms 0.4 m high with 0.3 m between them."""
PATCH = ((-1.9, -0.2), (-1.5, 0.2))
"""Of the floor, painted dark."""
BRIGHT, FLOOR, SHADE = (200, 170, 120), (90, 110, 160), (80, 60, 40)


def rectangle(low, high, z):
    """Return a level rectangle of two faces that look up."""
    return grid((*low, z), (high[0] - low[0], 0, 0), (0, high[1] - low[1], 0), (1, 1))


def boxes():
    """The place as it is: floor, tops, and walls of the platforms; and the colour of each sheet."""
    sheets = [(rectangle((-3, -3), (5, 3), 0.0), FLOOR), (rectangle(*PATCH, 0.001), SHADE)]
    up = (0, 0, HIGH)
    for x, X in ((-1.0, RIM), (FAR_RIM, 3.0)):
        sheets.append((rectangle((x, -0.6), (X, 0.6), HIGH), BRIGHT))
        sheets += [(grid((x, y, 0), (X - x, 0, 0), up, (1, 1)), SHADE) for y in (-0.6, 0.6)]
        sheets += [(grid((e, -0.6, 0), (0, 1.2, 0), up, (1, 1)), SHADE) for e in (x, X)]
    return sheets


def rays_of(vertices, faces):
    return RayScene(terrain(vertices, faces))


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A capture of six photographs from rims and sides, in whose depths dark pixels are unknown."""
    folder = tmp_path_factory.mktemp("platforms")
    sheets = boxes()
    rays = rays_of(*joined(*(sheet for sheet, _ in sheets)))
    colours = np.repeat(np.array([c for _, c in sheets], np.uint8), 2, axis=0)
    eyes = [(-1.5, 0.3, 1.5), (-0.6, -0.5, 1.6), (2.9, 0.2, 1.5), (3.6, -0.4, 1.6)]
    eyes += [(1.1, 2.2, 1.5), (1.2, -2.3, 1.6), (-3.0, 0.0, 1.5)]
    shots = []
    for number, eye in enumerate(eyes):
        target = (-1.7, 0.0, 0.0) if number == 6 else (1.15, 0.0, 0.3)
        camera = Camera.from_fovy(
            width=160,
            height=90,
            fovy=0.9,
            T_world_camera=look_at(np.array(eye, float), np.array(target, float)),
        )
        x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(90) + 0.5)
        local = np.stack(
            [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=-1
        ).reshape(-1, 3)
        away = local @ camera.T_world_camera[:3, :3].T
        length = np.linalg.norm(away, axis=1)
        origin = np.broadcast_to(np.array(eye, float), away.shape)
        depth, face = rays.cast(origin, away / length[:, None])
        shown = np.isfinite(depth)
        rgb = np.where(shown[:, None], colours[face], 230).astype(np.uint8)
        known = shown & (rgb != np.array(SHADE)).any(axis=1)
        z = np.where(known, depth / length, 0.0).reshape(90, 160).astype(np.float32)
        name = f"{number}.png"
        Image.fromarray(rgb.reshape(90, 160, 3)).save(folder / name)
        write_arrays(
            array_file(folder / "depth", name), depth=z, confidence=(z > 0).astype(np.float32)
        )
        shots.append(placed(name, camera))
    write_capture(captured(shots, metric=True, up=(0.0, 0.0, 1.0)), folder)
    return folder, read_capture(folder)


def surface(short=0.0):
    """What a reconstruction knows of it: tops and floor, with holes at the gap and at the patch.

    Tops end `short` metres before the rims.
    """
    (x, y), (X, Y) = PATCH
    quads = [
        rectangle((-1.0, -0.6), (RIM - short, 0.6), HIGH),
        rectangle((FAR_RIM + short, -0.6), (3.0, 0.6), HIGH),
        rectangle((-3, 0.6), (5, 3), 0.0),
        rectangle((-3, -3), (5, -0.6), 0.0),
        rectangle((3.0, -0.6), (5, 0.6), 0.0),
        rectangle((-3, -0.6), (x, 0.6), 0.0),
        rectangle((X, -0.6), (-1.0, 0.6), 0.0),
        rectangle((x, -0.6), (X, y), 0.0),
        rectangle((x, Y), (X, 0.6), 0.0),
    ]
    return grey(*joined(*quads))


def grey(vertices, faces):
    return ColourMesh(
        vertices=vertices, faces=faces, colours=np.full(vertices.shape, 128, np.uint8)
    )


@pytest.fixture(scope="module")
def dug(place):
    folder, capture = place
    return with_pits(surface(), capture, folder, folder / "depth", np.eye(4))


def heights(mesh, places):
    points = np.array(places, float)
    return rays_of(mesh.vertices, mesh.faces).height(points, z_from=np.full(len(points), 1.0))


def test_a_gap_between_platforms_is_as_deep_as_the_floor_beside_them(dug):
    mesh, pits = dug
    (pit,) = pits
    assert pit.depth == pytest.approx(HIGH, abs=0.01)
    assert pit.area == pytest.approx(0.3 * 1.2, rel=0.15)
    across = [(RIM + 0.05 * k, y) for k in range(1, 6) for y in (-0.4, 0.0, 0.4)]
    assert heights(mesh, across) == pytest.approx(0.0, abs=0.01)
    rims = [(RIM - 0.05, 0.0), (FAR_RIM + 0.05, 0.0)]
    assert heights(mesh, rims) == pytest.approx(HIGH, abs=0.01)


def test_nothing_is_open_between_a_pit_and_its_rims(place):
    """A foot or a policy's eye would meet nothing there, or what physics lays over it."""
    folder, capture = place
    mesh, _ = with_pits(surface(0.027), capture, folder, folder / "depth", np.eye(4))
    across = [(x, y) for x in np.arange(RIM - 0.1, FAR_RIM + 0.1, 0.003) for y in (-0.31, 0.0, 0.2)]
    found = heights(mesh, across)
    assert np.isfinite(found).all()
    assert np.minimum(np.abs(found), np.abs(found - HIGH)).max() < 0.01


def test_a_dark_patch_of_the_floor_stays_a_hole_that_nobody_has_seen_into(dug):
    mesh, _ = dug
    assert not np.isfinite(heights(mesh, [(-1.7, 0.0)])).any()


def test_a_pit_says_where_it_is_and_how_deep(dug):
    _, (pit,) = dug
    assert str(pit).startswith("a hole of 0.3")
    assert "at (1.1, " in str(pit) or "at (1.2, " in str(pit)
    assert "0.40 m deep, as low as the ground beside it" in str(pit)


def test_a_surface_without_holes_stays_as_it_is(place):
    folder, capture = place
    flat = grey(*rectangle((-6, -6), (8, 6), 0.0))
    mesh, pits = with_pits(flat, capture, folder, folder / "depth", np.eye(4))
    assert mesh is flat
    assert pits == []


@pytest.mark.parametrize(("uneven", "count"), [(0.0, 1), (1.0, 0)])
def test_what_has_no_level_rim_is_no_platform(uneven, count):
    """Between the leaves of two hedges it is as dark as between two platforms."""
    heights = np.zeros((40, 60))
    rows, columns = np.mgrid[:40, :60]
    high = (np.abs(columns - 29.5) < 20) & (np.abs(rows - 19.5) < 12)
    heights[high] = 0.4 + uneven * np.random.default_rng(0).random(int(high.sum()))
    deep = (np.abs(columns - 29.5) < 5) & (np.abs(rows - 19.5) < 12)
    heights[deep] = np.nan
    everywhere = np.ones(deep.shape, np.bool_)
    plan = _Plan(origin=np.zeros(2), cell=0.02, asked=everywhere, heights=heights)
    _, pits = _dug(surface(), plan, deep, np.eye(4))
    assert len(pits) == count
