"""Splat files that claim, or hold, more than a splat has."""

import gzip
import json
import struct

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_splat.files import read_splat, write_splat
from nw_splat.gaussians import MOST, Gaussians, check_count
from nw_splat.store import compile_store


def test_a_bomb_of_a_thousand_times_its_size_is_refused_before_it_goes_off(tmp_path):
    """5 million Gaussians are 80 MB of zeros, in a file of 80 kB."""
    count = 5_000_000
    body = struct.pack("<IIIBBBB", 0x5053474E, 2, count, 0, 12, 0, 0) + bytes(count * 19)
    (tmp_path / "a.spz").write_bytes(gzip.compress(body, 9))
    with pytest.raises(SceneError, match="claim to expand to"):
        read_splat(tmp_path / "a.spz")


def test_more_gaussians_than_any_place_has_are_refused():
    check_count("a.ply", MOST)
    with pytest.raises(SceneError, match=r"a\.ply: 12000001 Gaussians; 12000000 are read"):
        check_count("a.ply", MOST + 1)


def _cloud(count=20):
    return Gaussians(
        means=np.random.default_rng(0).normal(size=(count, 3)),
        log_scales=np.full((count, 3), -3.0),
        quats=np.tile([1.0, 0, 0, 0], (count, 1)),
        opacity_logits=np.full(count, 2.0),
        sh=np.zeros((count, 1, 3)),
    )


def test_gaussians_without_an_orientation_are_read_and_not_drawn(tmp_path):
    cloud = _cloud()
    cloud.quats[3:8] = 0.0
    write_splat(tmp_path / "a.ply", cloud)
    gaussians = read_splat(tmp_path / "a.ply")
    assert len(gaussians) == 20
    compile_store(gaussians, tmp_path / "a.nwsplat")
    from nw_splat.store import open_store

    assert open_store(tmp_path / "a.nwsplat").count == 15


@pytest.mark.parametrize(
    "said",
    [
        {"transform": [[10**400, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 1},
        {"transform": [[1e300, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 1},
        {"transform": np.eye(4)[:3].tolist(), "scale": 10**400},
        {"transform": np.eye(4)[:3].tolist(), "scale": 1e-300},
        {"transform": np.zeros((3, 4)).tolist(), "scale": 1},
        [1, 2],
    ],
)
def test_a_nerfstudio_transform_of_wild_numbers_is_refused(tmp_path, said):
    write_splat(tmp_path / "splat.ply", _cloud())
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps(said))
    with pytest.raises(SceneError, match=r"dataparser_transforms\.json: "):
        read_splat(tmp_path)
