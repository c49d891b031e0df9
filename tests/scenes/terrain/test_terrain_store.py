"""The cache of compiled terrain."""

import io
import os

import numpy as np
import pytest

from nw_base.files.cache import sealed_path
from nw_scenes import terrain as store
from nw_scenes.digest import digest
from nw_scenes.grid import TerrainOptions
from nw_scenes.mesh import box_mesh, merge, quad_mesh

MESH = merge(
    [
        quad_mesh((-5, -5, 0), (10, 0, 0), (0, 10, 0), "ground"),
        box_mesh((2.0, 0, 0.1), (0.3, 0.5, 0.1), (1, 0, 0, 0), "obstacle"),
        box_mesh((3.5, 0, 0.4), (0.2, 0.5, 0.03), (1, 0, 0, 0), "obstacle"),
    ]
)
WAY = {"trail": np.array([[2.0, 0.0, 0.2]]), "spawn": np.zeros(3)}


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path))


def test_the_second_time_comes_from_the_cache_and_is_the_same(monkeypatch):
    first = store.compiled_terrain(MESH, **WAY)
    monkeypatch.setattr(store, "build_terrain", lambda *_, **__: pytest.fail("compiled again"))
    second = store.compiled_terrain(MESH, **WAY)
    assert digest(first.solids) == digest(second.solids)
    assert first.findings == second.findings
    assert (first.floor, first.spawn_height) == (second.floor, second.spawn_height)


def test_a_damaged_file_is_compiled_again(tmp_path):
    first = store.compiled_terrain(MESH, **WAY)
    (path,) = tmp_path.rglob("*.npz")
    path.write_bytes(path.read_bytes()[:100])
    assert digest(store.compiled_terrain(MESH, **WAY).solids) == digest(first.solids)
    assert path.stat().st_size > 100


def test_flipped_bits_and_foreign_files_are_compiled_again(tmp_path, monkeypatch):
    first = store.compiled_terrain(MESH, **WAY)
    (path,) = tmp_path.rglob("*.npz")
    whole = path.read_bytes()
    other = io.BytesIO()
    np.savez(other, meta=np.zeros(3))
    compiled = []
    monkeypatch.setattr(store, "build_terrain", lambda *_, **__: compiled.append(1) or first)
    rng = np.random.default_rng(5)
    foreign = [b"", b"PK", other.getvalue(), bytes(len(whole))]
    for number in range(40):
        data = bytearray(whole)
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        path.write_bytes(foreign[number] if number < len(foreign) else data)
        os.utime(path, (number, number))  # Clocks of files tick slower than this loop.
        assert store.compiled_terrain(MESH, **WAY) is first
        assert len(compiled) == number + 1
        assert digest(store.compiled_terrain(MESH, **WAY).solids) == digest(first.solids)
    assert len(compiled) == 40


def test_a_sealed_file_of_another_kind_is_compiled_again(tmp_path):
    first = store.compiled_terrain(MESH, **WAY)
    (path,) = tmp_path.rglob("*.npz")
    with sealed_path(path) as temporary:
        temporary.write_bytes(b"a splat, say")
    assert digest(store.compiled_terrain(MESH, **WAY).solids) == digest(first.solids)


def test_what_changes_the_terrain_changes_the_key():
    options = TerrainOptions()
    key = store.terrain_key(MESH, options=options, **WAY)
    assert key != store.terrain_key(MESH, options=TerrainOptions(spacing=0.02), **WAY)
    assert key != store.terrain_key(
        MESH, options=options, trail=WAY["trail"] + 0.1, spawn=WAY["spawn"]
    )


def test_triangles_come_back_from_the_cache_as_triangles():
    exact = TerrainOptions(collision="triangles")
    first = store.compiled_terrain(MESH, options=exact, **WAY)
    second = store.compiled_terrain(MESH, options=exact, **WAY)
    assert digest(first.solids) == digest(second.solids)
