from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nw_places.bake.foliage import quats_from_normals
from nw_places.bake.materials import _TABLE, coat
from nw_places.bake.spots import Spots, hashed, noise, pulse, tiles
from nw_places.bake.surfels import cut, frames
from nw_places.entry import LIGHTS
from nw_places.places.parts import Decal, Patch
from nw_scenes.mesh import rotation_matrix


def _spots(count=400, blur=0.02, size=1.5, seed=0):
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(0, size, (2, count))
    normals = np.zeros((count, 3))
    normals[:, 1] = 1.0
    return Spots(
        p=np.stack([u, np.zeros(count), v], axis=1), n=normals, u=u, v=v, s=u, t=v,
        w=np.full(count, size), h=np.full(count, size), blur=np.full(count, blur),
        seed=np.full(count, 5, dtype=np.uint32), light=LIGHTS["noon"],
    )  # fmt: skip


@pytest.mark.parametrize("family", sorted(_TABLE))
@pytest.mark.parametrize("blur", [0.005, 0.1, 2.0])
def test_every_material_gives_finite_colours(family, blur):
    result = coat(family, _spots(blur=blur))
    assert result.albedo.shape == (400, 3)
    assert np.isfinite(result.albedo).all()
    assert -0.2 <= result.albedo.min() <= result.albedo.max() <= 2.0
    if result.glow is not None:
        assert np.isfinite(result.glow).all()


@given(
    period=st.floats(0.05, 1.0), share=st.floats(0.05, 0.95), blur=st.floats(0.001, 0.5),
)  # fmt: skip
def test_a_filtered_line_pattern_covers_its_share(period, share, blur):
    # Over one whole period the mean of the filtered pattern is the lines' share of it.
    x = (np.arange(2000) + 0.5) / 2000 * period
    seen = pulse(x, period, share * period, np.full(2000, blur))
    assert abs(seen.mean() - share) < 2e-3
    assert seen.min() > -1e-9
    assert seen.max() < 1 + 1e-9


def test_spots_as_large_as_a_pattern_see_only_its_mean():
    x = np.linspace(0, 3, 100)
    assert np.ptp(pulse(x, 0.3, 0.1, np.full(100, 0.3))) < 1e-9


def test_hashes_are_uniform_and_noise_is_smooth_and_centred():
    values = hashed(7, np.arange(20000), np.arange(20000) * 3 - 500)
    assert abs(values.mean() - 0.5) < 0.01
    assert abs(values.var() - 1 / 12) < 0.003
    points = np.stack([np.linspace(-50, 50, 50001), np.zeros(50001)], axis=1)
    field = noise(points, 1.0, 3)
    assert abs(field.mean()) < 0.15
    assert np.abs(np.diff(field)).max() < 0.01


def test_noise_is_the_same_as_when_it_was_written():
    # Frozen from the first version: exact arithmetic gives the same bits on every machine.
    assert hashed(1, np.array([0, -1, 12345]), np.array([2, 3, 4])).tolist() == [
        0.9610258196480572, 0.9107543479185551, 0.18545155390165746,
    ]  # fmt: skip
    points = np.array([[0.3, -1.7, 2.2], [10.1, 0.0, 5.5]])
    assert noise(points, 0.7, 9).tolist() == [0.5145915072712224, 0.36527578853987364]


def test_bricks_are_shifted_by_half_in_every_other_row():
    u = np.array([0.05, 0.05])
    v = np.array([0.03, 0.11])
    laid = tiles(u, v, size=(0.2, 0.075), joint=0.01, blur=np.full(2, 0.001), seed=1, shift=0.5)
    assert laid.row.tolist() == [0, 1]
    assert np.allclose(laid.u, [0.05, 0.15])


def test_cells_fill_their_patch_and_keep_to_decals():
    patch = Patch(
        origin=(0.0, -1.0, 0.0), u=(3.0, 0.0, 0.0), v=(0.0, 2.0, 0.0), material="concrete",
        decals=(Decal(rect=(0.5, 0.5, 1.3, 0.9), material="stripe"),),
    )  # fmt: skip
    cells = cut([patch], frames([patch]), [(0.0, 0.0, 0.3), (1.0, 0.0, 0.3)], 4.0)
    area = cells.width * cells.height
    assert abs(area.sum() - 6.0) < 1e-9
    assert abs(area[cells.decal == 0].sum() - 0.8 * 0.4) < 1e-9
    inside = cells.decal == 0
    assert (cells.s[inside] - cells.width[inside] / 2).min() >= 0.5 - 1e-9
    assert (cells.s[inside] + cells.width[inside] / 2).max() <= 1.3 + 1e-9
    near = np.hypot(cells.s - 0.5, cells.t - 1.0) < 0.3
    far = cells.s > 2.5
    assert area[near].mean() < area[far].mean()


@given(st.tuples(*[st.floats(-1, 1)] * 3), st.floats(0, 6.2))
def test_rotations_from_normals_turn_z_to_the_normal(normal, spin):
    length = np.linalg.norm(normal)
    if length < 0.1:
        return
    unit = np.array(normal) / length
    quat = quats_from_normals(unit[None], np.array([spin]))[0]
    assert np.allclose(rotation_matrix(quat)[:, 2], unit, atol=1e-6)


@given(st.integers(-320, 0), st.floats(0, 6.2), st.floats(0, 6.2))
def test_rotations_are_exact_however_close_a_normal_is_to_minus_z(power, way, spin):
    off = 10.0**power
    unit = np.array([np.sin(off) * np.cos(way), np.sin(off) * np.sin(way), -np.cos(off)])
    spun, plain = quats_from_normals(np.stack([unit, unit]), np.array([spin, 0.0]))
    for quat in (spun, plain):
        assert np.abs(rotation_matrix(quat)[:, 2] - unit).max() < 1e-15
    # The shortest turn has an axis across z, and leaves `off` of a half turn.
    assert plain[3] == 0.0
    assert plain[0] == pytest.approx(np.sin(off / 2), rel=1e-12, abs=1e-150)


def test_z_itself_is_left_and_minus_z_is_half_a_turn_away():
    poles = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert quats_from_normals(poles, np.zeros(2)).tolist() == [[1, 0, 0, 0], [0, 1, 0, 0]]
