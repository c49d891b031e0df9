"""Kernels that finish pictures give the bits of NumPy's expressions, which stand here."""

import subprocess
import sys

import numpy as np
import pytest

from nw_sim.sensors.drawing import overlay
from nw_splat.camera import Camera, Pixels, look_at
from nw_splat.image import Image, composite
from nw_splat.kernels import insert


def picture(height, width, *, seed=0):
    rng = np.random.default_rng(seed)
    return Image(
        rgb=rng.uniform(-0.1, 1.3, (height, width, 3)).astype(np.float32),
        depth=rng.uniform(0, 9, (height, width)).astype(np.float32),
        alpha=rng.choice([0.0, 5e-4, 0.3, 1.0], (height, width)).astype(np.float32)
        * rng.random((height, width), dtype=np.float32),
    )


def same_bits(ours, theirs):
    return ours.dtype == theirs.dtype and np.array_equal(ours, theirs, equal_nan=True)


def test_the_mean_of_four_samples_is_numpys():
    image, new = picture(90, 160), picture(45, 80)

    def mean(values):
        top, bottom = values[0::2], values[1::2]
        total = (top[:, 0::2] + top[:, 1::2]) + (bottom[:, 0::2] + bottom[:, 1::2])
        return (total * np.float32(0.25)).astype(np.float32)

    insert.mean_of_four(image.rgb, image.depth, image.alpha, new.rgb, new.depth, new.alpha)
    assert same_bits(new.rgb, mean(image.rgb))
    assert same_bits(new.alpha, mean(image.alpha))
    depth = mean(image.depth * image.alpha) / np.maximum(mean(image.alpha), np.float32(1e-10))
    assert same_bits(new.depth, depth)


@pytest.mark.parametrize("seed", range(3))
def test_blending_objects_is_numpys(seed):
    image, drawn = picture(40, 50, seed=seed), picture(40, 50, seed=seed + 10)
    rng = np.random.default_rng(seed)
    depth = np.where(rng.random((40, 50)) < 0.2, np.inf, drawn.depth).astype(np.float32)
    coverage = rng.uniform(-0.2, 1.2, (40, 50)).astype(np.float32)
    background = (0.9, 0.3, 1.0)

    there = np.isfinite(depth)
    share = np.where(there, np.clip(coverage, 0.0, 1.0), 0.0).astype(np.float32)
    z = np.where(there, depth, 0.0).astype(np.float32)
    before = (image.alpha < 1e-3) | (z < image.depth)
    through = 1.0 - image.alpha
    behind = image.rgb + through[..., None] * (drawn.rgb - np.asarray(background, np.float32))
    shown = np.where(before[..., None], drawn.rgb, behind)
    of_object = np.where(before, share, share * through)
    of_splat = np.where(before, (1.0 - share) * image.alpha, image.alpha)
    total = of_object * z + of_splat * image.depth

    out = composite(image, drawn.rgb, depth, coverage, background=background)
    assert same_bits(out.rgb, image.rgb + share[..., None] * (shown - image.rgb))
    assert same_bits(out.alpha, of_object + of_splat)
    assert same_bits(out.depth, total / np.maximum(of_object + of_splat, 1e-10))


def light(rgb, down, row, column):
    """Light around pixels as NumPy works it out."""
    step = tuple(slice(None, None, max(1, size // 45)) for size in rgb.shape[:2])
    weight = np.where(down[step] > 0.02, 1.0, 1e-4)[..., np.newaxis]
    cells = np.concatenate([np.clip(rgb[step], 0.0, 1.0) * weight, weight], axis=-1)
    for axis, most in enumerate((9, 16)):
        size = cells.shape[axis]
        count = min(size, most)
        cells = np.add.reduceat(cells, np.arange(count) * size // count, axis=axis)
    rows, columns = (
        np.maximum(3.0 - np.abs(np.subtract.outer(np.arange(n), np.arange(n))), 0.0)
        for n in cells.shape[:2]
    )
    around = np.moveaxis(rows @ np.moveaxis(cells, 2, 0) @ columns, 0, 2)
    total = around + 1e-2 * cells.sum(axis=(0, 1))
    means = total[..., :3] / total[..., 3:]
    low, share = [], []
    for axis, index in enumerate((row, column)):
        count = means.shape[axis]
        at = np.clip((index + 0.5) * count / rgb.shape[axis] - 0.5, 0.0, count - 1.0)
        low.append(np.minimum(at.astype(np.intp), max(count - 2, 0)))
        share.append((at - low[-1])[:, np.newaxis])
    (i, j), (v, u) = low, share
    k, m = np.minimum(i + 1, means.shape[0] - 1), np.minimum(j + 1, means.shape[1] - 1)
    upper = (1.0 - u) * means[i, j] + u * means[i, m]
    lower = (1.0 - u) * means[k, j] + u * means[k, m]
    mean = (1.0 - v) * upper + v * lower
    grey = (mean * np.array([0.2126, 0.7152, 0.0722])).sum(axis=-1, keepdims=True)
    brightness = np.clip(grey / 0.46, 0.15, 1.1)
    tint = 1.0 + 0.35 * (mean / np.maximum(grey, 1e-3) - 1.0)
    return (brightness * tint).astype(np.float32)


@pytest.mark.parametrize(
    "size", [(45, 80), (90, 160), (89, 179), (44, 200), (7, 5), (1, 1), (360, 640)]
)
def test_light_around_objects_is_numpys(size):
    rng = np.random.default_rng(sum(size))
    rgb = rng.uniform(-0.1, 1.3, (*size, 3)).astype(np.float32) * rng.choice([0.2, 1.0])
    down = rng.uniform(-0.5, 0.6, size)
    row, column = np.nonzero(rng.random(size) < 0.3)
    assert same_bits(overlay.light_around(rgb, down, row, column), light(rgb, down, row, column))


def test_soft_outlines_are_numpys():
    camera = Camera.from_fovy(
        width=80, height=45, fovy=0.9, T_world_camera=look_at((0.0, 0.0, 0.15), (1.0, 0.05, 0.1))
    )
    flat = overlay.ray_directions(camera, Pixels()).reshape(-1, 3)
    rng = np.random.default_rng(5)
    inside = np.zeros((45, 80), dtype=bool)
    inside[10:30, 20:40] = inside[0, :5] = inside[40:, 78:] = True
    edges = np.zeros_like(inside)
    for axis in (0, 1):
        changes = np.diff(inside, axis=axis)
        ahead, behind = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
        ahead[axis], behind[axis] = (1, 0), (0, 1)
        edges |= np.pad(changes, ahead) | np.pad(changes, behind)
    found = np.empty(inside.size, dtype=np.intp)
    edge = found[: insert.outline(inside, found)]
    assert np.array_equal(edge, np.flatnonzero(edges))

    thirds = (-1.0 / 3.0, 0.0, 1.0 / 3.0)
    offsets = np.array([(x, y, 0.0) for y in thirds for x in thirds]) * (0.013, 0.017, 0.0)
    rays = np.empty((9 * len(edge), 3))
    insert.rays_around(flat, edge, offsets, rays)
    expected = (flat[edge] / flat[edge, 2:])[:, np.newaxis] + offsets
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    assert same_bits(rays, expected.reshape(-1, 3))

    near = np.where(rng.random(len(rays)) < 0.5, np.inf, rng.uniform(0.1, 30.0, len(rays)))
    near[:9] = np.inf
    seen = rng.random((len(rays), 3), dtype=np.float32)
    depth, colour, coverage = np.ones(3600), np.ones((3600, 3), np.float32), np.ones(3600, "f4")
    insert.soften(near, seen, edge, depth, colour, coverage)
    hit = np.isfinite(near).reshape(-1, 9)
    weight = hit / np.maximum(hit.sum(axis=1), 1)[:, np.newaxis]
    finite = np.where(hit, near.reshape(-1, 9), 0.0)
    depths = np.where(hit.any(axis=1), (finite * weight).sum(axis=1), np.inf)
    assert same_bits(depth[edge], depths)
    assert same_bits(coverage[edge], (hit.sum(axis=1) / 9).astype(np.float32))
    colours = (seen.reshape(-1, 9, 3) * weight[..., np.newaxis]).sum(axis=1).astype(np.float32)
    assert same_bits(colour[edge], colours)


def test_after_warming_up_nothing_that_draws_objects_compiles():
    program = """\
from dataclasses import replace
import numpy as np
from nw_sim.sensors.drawing import overlay
from nw_scenes.mesh import cone_mesh
from nw_scenes.rays import RayScene
from nw_splat.camera import Camera, Pixels, look_at
from nw_splat.image import Image
from nw_splat.kernels import insert
from nw_sim.warmup import warmup

warmup(kernels=("ray",))
kernels = [each for each in vars(insert).values() if hasattr(each, "signatures")]
kinds = [len(each.signatures) for each in kernels]
T = look_at((0.0, 0.0, 0.15), (1.0, 0.05, 0.1))
camera = Camera.from_fovy(width=40, height=24, fovy=0.9, T_world_camera=T)
directions = overlay.ray_directions(camera, Pixels())
mesh = cone_mesh().mesh
static = RayScene(replace(mesh, vertices=mesh.vertices + 50.0))
cones = overlay.Cones(np.array([[0.6, 0.02, 0.0], [1.1, -0.1, 0.0]]))
drawn = overlay.draw(
    directions, T, cones=cones, robot=None, static=static, pitch=(1 / camera.fx, 1 / camera.fy)
)
image = Image(
    rgb=np.ones((24, 40, 3), np.float32),
    depth=np.ones((24, 40), np.float32),
    alpha=np.ones((24, 40), np.float32),
)
for part in (image.rgb, image.depth, image.alpha):
    part.flags.writeable = False
for _ in range(2):
    before = image
    image = overlay.insert(
        image, drawn, directions=directions, T_world_camera=T, static=static
    )
    assert not np.array_equal(before.rgb, image.rgb)
print(sum(kinds), sum(len(each.signatures) for each in kernels))
"""
    out = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    before, after = map(int, out.stdout.split())
    assert before == after >= 9
