"""Compiled splats, as the cache holds them, are read back: what they show, and where damaged."""

import numpy as np
import pytest
from splat_rooms import cloud

from nw_base.errors import SceneError
from nw_base.files.cache import read_sealed, sealed_path
from nw_splat.files import read_splat
from nw_splat.portrait import framing_camera
from nw_splat.render import CpuRenderer
from nw_splat.store import compile_store, memory_store


@pytest.mark.parametrize("degree", [0, 3])
def test_what_is_read_back_looks_as_what_was_compiled(tmp_path, degree):
    gaussians = cloud(3000, degree=degree)
    compile_store(gaussians, tmp_path / "a.nwsplat")
    back = read_splat(tmp_path / "a.nwsplat")
    assert back.sh_degree == degree
    camera = framing_camera(gaussians, width=96, height=72)
    ours, theirs = (CpuRenderer(memory_store(g)).render(camera).rgb for g in (back, gaussians))
    assert theirs.std() > 0.02
    assert np.abs(ours - theirs).max() < 1e-3


def test_scales_and_opacities_survive_and_rotations_are_rotations(tmp_path):
    gaussians = cloud(500)
    compile_store(gaussians, tmp_path / "a.nwsplat")
    back = read_splat(tmp_path / "a.nwsplat")
    # Compiling orders them anew.
    here, there = (np.lexsort(g.means.T) for g in (back, gaussians))
    assert np.array_equal(back.means[here], gaussians.means[there])
    widths = np.sort(gaussians.log_scales[there], axis=1)
    assert np.sort(back.log_scales[here], axis=1) == pytest.approx(widths, abs=2e-3)
    assert back.opacity_logits[here] == pytest.approx(gaussians.opacity_logits[there], abs=1e-4)
    assert np.linalg.norm(back.quats, axis=1) == pytest.approx(np.ones(500), abs=1e-6)


def test_it_is_told_by_its_content_whatever_its_name(tmp_path):
    compile_store(cloud(20), tmp_path / "a.splat")
    assert len(read_splat(tmp_path / "a.splat")) == 20


def test_a_sealed_file_of_nonsense_is_read_without_it(tmp_path):
    compile_store(cloud(20), tmp_path / "a.nwsplat")
    content = bytearray(read_sealed(tmp_path / "a.nwsplat"))
    # The first group's covariance xx; the header takes 4096 bytes, a value sixteen times four.
    content[4096 + 3 * 64 : 4096 + 4 * 64] = np.full(16, np.nan, dtype="<f4").tobytes()
    with sealed_path(tmp_path / "b.nwsplat") as temporary:
        temporary.write_bytes(content)
    assert len(read_splat(tmp_path / "b.nwsplat")) == 4


def test_a_damaged_one_says_so(tmp_path):
    compile_store(cloud(20), tmp_path / "a.nwsplat")
    content = bytearray((tmp_path / "a.nwsplat").read_bytes())
    content[5000] ^= 1
    (tmp_path / "a.nwsplat").write_bytes(content)
    with pytest.raises(SceneError, match=r"a\.nwsplat: its content is not what was written"):
        read_splat(tmp_path / "a.nwsplat")
