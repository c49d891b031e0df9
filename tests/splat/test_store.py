"""The compiled store: what it holds, how much, and what it refuses."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from splat_rooms import cloud, eye_camera, room

from nw_base.errors import SceneError
from nw_base.files.cache import read_sealed, sealed_path
from nw_splat.files import compiled_store, write_splat
from nw_splat.gaussians import Gaussians
from nw_splat.render import CpuRenderer
from nw_splat.store import compile_store, memory_store, open_store, unpack


@pytest.fixture
def compiled(tmp_path):
    path = tmp_path / "room.nwsplat"
    compile_store(room(5000), path, key="room")
    return path


def forge(path, data):
    """Write another content with a right seal, as nobody but this program does."""
    with sealed_path(path) as temporary:
        temporary.write_bytes(data)


def test_a_file_holds_what_was_compiled(compiled):
    store, memory = open_store(compiled, key="room"), memory_store(room(5000))
    assert store.count == memory.count
    for name, array in store.layout.arrays().items():
        assert np.array_equal(array, memory.layout.arrays()[name])
        assert not array.flags.writeable
    camera = eye_camera(0, 64, 48)
    a, b = CpuRenderer(store).render(camera), CpuRenderer(memory).render(camera)
    assert np.array_equal(a.rgb, b.rgb)


def test_a_gaussian_with_sh3_takes_at_most_150_bytes(tmp_path):
    path = tmp_path / "room.nwsplat"
    compile_store(room(50_000), path)
    store = open_store(path)
    assert store.nbytes / store.count <= 150
    assert path.stat().st_size / store.count <= 150


def test_every_visible_gaussian_is_in_the_layout_once():
    gaussians = cloud(1000, degree=2)
    splats = unpack(memory_store(gaussians).layout)
    visible = gaussians.take(1 / (1 + np.exp(-gaussians.opacity_logits)) >= 1 / 255)
    assert len(splats.means) == len(visible)
    a, b = np.lexsort(splats.means.T), np.lexsort(visible.means.T)
    assert np.array_equal(splats.means[a], visible.means[b])
    assert np.abs(splats.sh[a] - visible.sh[b]).max() < 1e-3
    trace = np.trace(splats.covariances, axis1=1, axis2=2)
    assert trace[a] == pytest.approx(np.exp(2 * visible.log_scales[b]).sum(axis=1), rel=1e-5)


def test_what_cannot_be_seen_is_left_out():
    gaussians = cloud(600, degree=0)
    gaussians.means[0, 1] = np.nan
    gaussians.log_scales[1, 0] = np.inf
    gaussians.quats[2] = 0
    gaussians.sh[3, 0, 0] = np.inf
    gaussians.opacity_logits[:] = 0
    gaussians.opacity_logits[4] = -9
    assert memory_store(gaussians).count == 595


def test_nothing_to_see_is_an_error():
    gaussians = cloud(10)
    gaussians.opacity_logits[:] = -20
    with pytest.raises(SceneError, match="none of 10 Gaussians can be seen"):
        memory_store(gaussians)


@pytest.mark.parametrize("keep", [0, 1, 100, 4095, 4096, 5000, -1, -8])
def test_a_file_cut_short_does_not_open(compiled, keep):
    data = compiled.read_bytes()
    compiled.write_bytes(data[:keep])
    with pytest.raises(SceneError, match=r"room\.nwsplat: .*rebuilt on the next use"):
        open_store(compiled)


def test_a_longer_file_and_a_missing_one_do_not_open(compiled):
    compiled.write_bytes(compiled.read_bytes() + b"x")
    with pytest.raises(SceneError, match="its end is missing or changed"):
        open_store(compiled)
    compiled.unlink()
    with pytest.raises(SceneError, match="No such file"):
        open_store(compiled)


def test_another_content_or_format_does_not_open(compiled):
    with pytest.raises(SceneError, match="holds 'room', not 'other'"):
        open_store(compiled, key="other")
    data = bytearray(read_sealed(compiled))
    data[:4096] = data[:4096].replace(b'"format": ', b'"format": 9')[:4096]
    forge(compiled, data)
    with pytest.raises(SceneError, match="store format 95"):
        open_store(compiled)


def test_a_header_that_lies_about_its_arrays_does_not_open(compiled):
    data = bytearray(read_sealed(compiled))
    header = json.loads(data[:4096])
    for change in ({"count": 99_999}, {"sh_count": 5}, {"arrays": {}}, {"count": -4}):
        lying = json.dumps(header | change).encode().ljust(4095) + b"\n"
        forge(compiled, lying + data[4096:])
        with pytest.raises(SceneError, match=r"its header"):
            open_store(compiled)


def test_damage_within_the_arrays_breaks_the_picture_at_most(compiled):
    # Any bit pattern in the values that kernels read: not a number, infinite, denormal.
    data = bytearray(read_sealed(compiled))
    places = json.loads(data[:4096])["arrays"]
    rng = np.random.default_rng(0)
    for name in ("geometry", "dc", "sh"):
        start, count = places[name]
        width = 2 if name == "sh" else 4
        data[start : start + width * count] = rng.bytes(width * count)
    forge(compiled, data)
    image = CpuRenderer(open_store(compiled)).render(eye_camera(0, 96, 64))
    assert image.rgb.shape == (64, 96, 3)
    start, count = places["bounds"]
    data[start : start + 4] = np.float32(np.nan).tobytes()
    forge(compiled, data)
    with pytest.raises(SceneError, match="its bounds are damaged"):
        open_store(compiled)


def test_the_cache_compiles_once_and_heals(own_cache):
    gaussians = cloud(500)
    path = compiled_store(gaussians)
    assert own_cache in path.parents
    stamp = path.stat().st_mtime_ns
    assert compiled_store(gaussians) == path
    assert path.stat().st_mtime_ns == stamp
    path.write_bytes(path.read_bytes()[:1000])
    assert compiled_store(gaussians) == path
    assert open_store(path).count == memory_store(gaussians).count
    assert compiled_store(cloud(500, seed=1)) != path


@pytest.mark.usefixtures("own_cache")
def test_a_flipped_bit_anywhere_is_seen_and_mended():
    gaussians = cloud(500)
    path = compiled_store(gaussians)
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    places = [0, 4095, 4096, len(whole) - 49, len(whole) - 48, len(whole) - 1]
    for time, place in enumerate([*places, *rng.integers(len(whole), size=60)]):
        data = bytearray(whole)
        data[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        os.utime(path, (time, time))  # Clocks of files tick slower than this loop.
        with pytest.raises(SceneError, match="rebuilt on the next use"):
            open_store(path)
        assert compiled_store(gaussians) == path
        assert path.read_bytes() == whole


def test_a_splat_file_is_compiled_by_its_content(own_cache, tmp_path):
    write_splat(tmp_path / "a.ply", cloud(100))
    write_splat(tmp_path / "b.ply", cloud(100))
    assert compiled_store(tmp_path / "a.ply") == compiled_store(tmp_path / "b.ply")
    with pytest.raises(SceneError, match="No such file"):
        compiled_store(tmp_path / "c.ply")
    assert list(own_cache.glob("splats/.*")) == []


def test_shapes_that_do_not_agree_name_the_field():
    good = cloud(4)
    with pytest.raises(SceneError, match=r"Gaussians\.quats has shape \(4, 3\); give \(4, 4\)"):
        Gaussians(
            means=good.means,
            log_scales=good.log_scales,
            quats=good.quats[:, :3],
            opacity_logits=good.opacity_logits,
            sh=good.sh,
        )
    with pytest.raises(SceneError, match="5 coefficients"):
        Gaussians(
            means=good.means,
            log_scales=good.log_scales,
            quats=good.quats,
            opacity_logits=good.opacity_logits,
            sh=np.zeros((4, 5, 3), dtype=np.float32),
        )


def test_importing_the_package_loads_neither_numba_nor_torch():
    modules = "nw_splat.files, nw_splat.image, nw_splat.portrait, nw_splat.warmup"
    code = f"import sys, {modules}; print({{'numba', 'torch', 'PIL'}} & set(sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "set()"


def test_the_kernel_cache_is_named_after_every_kernel_source(tmp_path):
    from nw_base import machine_code as jit

    (tmp_path / "a.py").write_text("x = 1")
    before = jit.hash_sources(tmp_path)
    (tmp_path / "b.py").write_text("y = 1")
    with_other = jit.hash_sources(tmp_path)
    (tmp_path / "b.py").write_text("y = 2")
    assert len({before, with_other, jit.hash_sources(tmp_path)}) == 3


def test_the_layout_and_the_kernels_agree_on_its_sizes():
    from nw_splat import store as layout
    from nw_splat.kernels import cull, project

    kernels = (project.CHUNK, project.GROUP, project.GEOMETRY, cull.BOUNDS)
    assert kernels == (layout.CHUNK, layout.GROUP, layout.GEOMETRY, layout.BOUNDS)
