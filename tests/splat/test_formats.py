"""Splat files: round trips, conventions, files made by other tools, and precise errors."""

import gzip
import json
import math
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_rooms import cloud

from nw_base.errors import SceneError, UsageError
from nw_base.files.ply import Ply
from nw_splat.camera import Camera, look_at
from nw_splat.files import read_splat, write_splat
from nw_splat.files.ply import read_threedgs_ply
from nw_splat.files.spz import write_spz
from nw_splat.gaussians import harmonics, rotate_harmonics, transformed
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store

FIXTURES = Path(__file__).parent / "fixtures"


def _sigmoid(x):
    return 1 / (1 + np.exp(-x.astype(np.float64)))


def _same_turn(a, b):
    """Least |cosine| between the quaternions of two sets."""
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (a, b))
    return np.abs((a * b).sum(axis=1)).min()


def _same_order(gaussians, other):
    """Reorder `other` so that its centres match."""
    order = np.linalg.norm(gaussians.means[:, None] - other.means[None], axis=2).argmin(axis=1)
    assert len(set(order.tolist())) == len(gaussians)
    return other.take(order)


@settings(max_examples=25, deadline=None)
@given(count=st.integers(1, 300), degree=st.integers(0, 3), seed=st.integers(0, 999))
def test_ply_round_trip_is_exact(tmp_path_factory, count, degree, seed):
    path = tmp_path_factory.mktemp("ply") / "a.ply"
    gaussians = cloud(count, degree=degree, seed=seed)
    write_splat(path, gaussians)
    back = read_splat(path)
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        assert np.array_equal(getattr(back, name), getattr(gaussians, name))


@settings(max_examples=25, deadline=None)
@given(
    count=st.integers(1, 300),
    degree=st.integers(0, 3),
    seed=st.integers(0, 999),
    version=st.sampled_from([2, 3, 4]),
)
def test_spz_round_trip_keeps_its_precision(tmp_path_factory, count, degree, seed, version):
    if version == 4:
        pytest.importorskip("zstandard")
    path = tmp_path_factory.mktemp("spz") / "a.spz"
    gaussians = cloud(count, degree=degree, seed=seed)
    write_spz(path, gaussians, version=version)
    back = read_splat(path)
    assert np.abs(back.means - gaussians.means).max() <= 1.0001 / 8192
    in_range = (gaussians.log_scales > -10) & (gaussians.log_scales < 5.9)
    assert np.abs(back.log_scales - gaussians.log_scales)[in_range].max() <= 1.0001 / 32
    assert _same_turn(back.quats, gaussians.quats) > (0.995 if version == 2 else 0.99999)
    assert np.abs(_sigmoid(back.opacity_logits) - _sigmoid(gaussians.opacity_logits)).max() < 0.0021
    assert np.abs(back.sh - gaussians.sh)[:, 0].max() <= 0.0132
    rest = np.clip(gaussians.sh[:, 1:], -1, 127 / 128)
    assert np.abs(back.sh[:, 1:] - rest).max(initial=0) <= 1.0001 / 256


def test_dot_splat_round_trip_keeps_its_precision(tmp_path):
    gaussians = cloud(200, degree=0)
    write_splat(tmp_path / "a.splat", gaussians)
    back = _same_order(gaussians, read_splat(tmp_path / "a.splat"))
    assert np.array_equal(back.means, gaussians.means)
    assert np.abs(back.log_scales - gaussians.log_scales).max() < 1e-6
    assert _same_turn(back.quats, gaussians.quats) > 0.9998
    assert np.abs(_sigmoid(back.opacity_logits) - _sigmoid(gaussians.opacity_logits)).max() < 0.0021
    shown = np.clip(0.5 + 0.28209479 * gaussians.sh[:, 0], 0, 1)
    assert np.abs(0.5 + 0.28209479 * back.sh[:, 0] - shown).max() <= 0.5001 / 255


def test_dot_splat_drops_harmonics_and_puts_the_prominent_first(tmp_path):
    gaussians = cloud(200, degree=3)
    write_splat(tmp_path / "a.splat", gaussians)
    back = read_splat(tmp_path / "a.splat")
    assert back.sh.shape == (200, 1, 3)
    weight = np.exp(back.log_scales.sum(axis=1)) * _sigmoid(back.opacity_logits)
    assert weight[:20].min() > weight[-20:].max()


@pytest.mark.parametrize("name", ["cloud.compressed.ply", "cloud.spz"])
def test_files_of_playcanvas_splat_transform_come_back_as_the_ply_they_were_made_from(name):
    # Made by @playcanvas/splat-transform 2.7.1 from cloud.ply, which has no symmetry: a wrong axis,
    # quaternion order or harmonic sign moves values by far more than the formats' precision.
    gaussians = read_splat(FIXTURES / "cloud.ply")
    back = _same_order(gaussians, read_splat(FIXTURES / name))
    assert np.abs(back.means - gaussians.means).max() < 2e-3
    assert np.abs(back.log_scales - gaussians.log_scales).max() < 0.032
    assert _same_turn(back.quats, gaussians.quats) > 0.99999
    assert np.abs(_sigmoid(back.opacity_logits) - _sigmoid(gaussians.opacity_logits)).max() < 0.0021
    assert np.abs(back.sh[:, 0] - gaussians.sh[:, 0]).max() < 0.0132
    # splat-transform keeps four bits of the harmonics of degree 2 and 3 in SPZ.
    assert np.abs(back.sh[:, 1:] - gaussians.sh[:, 1:]).max() < 0.07
    assert np.abs(gaussians.sh[:, 1:]).max() > 0.3


def _coefficient_major(path, gaussians):
    """Write as the published toolchain does: f_rest_{3k+c}."""
    write_splat(path, gaussians)
    data = path.read_bytes().replace(b"comment f_rest order: channel\n", b"")
    head, body = data.split(b"end_header\n", 1)
    rows = np.frombuffer(body, np.float32).reshape(len(gaussians), -1).copy()
    rest = gaussians.sh.shape[1] - 1
    rows[:, 6 : 6 + 3 * rest] = gaussians.sh[:, 1:].reshape(len(gaussians), -1)
    path.write_bytes(head + b"end_header\n" + rows.tobytes())


def _photographic(count, degree):
    """Harmonics as training leaves them: the channels of a coefficient go together."""
    gaussians = cloud(count, degree=degree)
    rng = np.random.default_rng(1)
    shared = rng.normal(size=(count, gaussians.sh.shape[1], 1)) * 0.1
    gaussians.sh[:] = shared + rng.normal(size=gaussians.sh.shape) * 0.05
    return gaussians


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_order_of_f_rest_is_found_out(tmp_path, degree):
    gaussians = _photographic(500, degree)
    _coefficient_major(tmp_path / "published.ply", gaussians)
    assert np.array_equal(read_splat(tmp_path / "published.ply").sh, gaussians.sh)
    write_splat(tmp_path / "usual.ply", gaussians)
    usual = (tmp_path / "usual.ply").read_bytes()
    (tmp_path / "usual.ply").write_bytes(usual.replace(b"comment f_rest order: channel\n", b""))
    assert np.array_equal(read_splat(tmp_path / "usual.ply").sh, gaussians.sh)


def test_the_order_of_f_rest_can_be_told(tmp_path):
    gaussians = cloud(50)
    _coefficient_major(tmp_path / "a.ply", gaussians)
    ply = Ply.open(tmp_path / "a.ply")
    told = read_threedgs_ply(ply, rest_order="coefficient")
    assert np.array_equal(told.sh, gaussians.sh)
    assert not np.array_equal(read_threedgs_ply(ply, rest_order="channel").sh, gaussians.sh)


def test_big_endian_and_double_ply_and_extra_columns_are_read(tmp_path):
    names = ["x", "y", "z", "nx", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    rows = np.arange(2 * len(names), dtype=">f8").reshape(2, -1)
    head = "ply\r\nformat binary_big_endian 1.0\r\nobj_info x\r\nelement vertex 2\r\n"
    head += "".join(f"property double {name}\r\n" for name in names) + "end_header\r\n"
    (tmp_path / "a.ply").write_bytes(head.encode() + rows.tobytes())
    back = read_splat(tmp_path / "a.ply")
    assert back.means.tolist() == [[0, 1, 2], [15, 16, 17]]
    assert back.quats[1].tolist() == [26, 27, 28, 29]
    assert back.sh[0, 0].tolist() == [4, 5, 6]


def _checkpoint(gaussians):
    return {
        "means": torch.tensor(gaussians.means),
        "scales": torch.tensor(gaussians.log_scales),
        "quats": torch.tensor(gaussians.quats),
        "opacities": torch.tensor(gaussians.opacity_logits),
        "sh0": torch.tensor(gaussians.sh[:, :1]),
        "shN": torch.tensor(gaussians.sh[:, 1:]),
    }


@pytest.mark.parametrize("wrapped", [True, False])
def test_a_gsplat_checkpoint_is_read(tmp_path, wrapped):
    gaussians = cloud(40)
    content = _checkpoint(gaussians)
    torch.save({"step": 29999, "splats": content} if wrapped else content, tmp_path / "a.pt")
    back = read_splat(tmp_path / "a.pt")
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        assert np.array_equal(getattr(back, name), getattr(gaussians, name))


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_a_gsplat_checkpoint_is_written_as_trainers_write_it(tmp_path, degree):
    gaussians = cloud(40, degree=degree)
    write_splat(tmp_path / "a.pt", gaussians)
    content = torch.load(tmp_path / "a.pt", weights_only=True)
    assert content["step"] == 0
    assert {key: tuple(value.shape) for key, value in content["splats"].items()} == {
        "means": (40, 3),
        "scales": (40, 3),
        "quats": (40, 4),
        "opacities": (40,),
        "sh0": (40, 1, 3),
        "shN": (40, 15, 3),
    }
    back = read_splat(tmp_path / "a.pt")
    for name in ("means", "log_scales", "quats", "opacity_logits"):
        assert np.array_equal(getattr(back, name), getattr(gaussians, name))
    count = gaussians.sh.shape[1]
    assert np.array_equal(back.sh[:, :count], gaussians.sh)
    assert not back.sh[:, count:].any()
    write_splat(tmp_path / "b.pt", gaussians)
    assert (tmp_path / "a.pt").read_bytes() == (tmp_path / "b.pt").read_bytes()


class _Boom:
    def __reduce__(self):
        return (print, ("code of the file ran",))


def test_a_checkpoint_with_code_in_it_is_refused(tmp_path, capsys):
    torch.save(_checkpoint(cloud(4)) | {"extra": _Boom()}, tmp_path / "a.pt")
    with pytest.raises(SceneError, match="torch cannot load it"):
        read_splat(tmp_path / "a.pt")
    assert "code of the file ran" not in capsys.readouterr().out


def test_checkpoints_that_claim_more_than_they_hold_are_refused(tmp_path):
    content = _checkpoint(cloud(4))
    content["means"] = torch.zeros(1).expand(1 << 40, 3)
    torch.save(content, tmp_path / "wide.pt")
    with pytest.raises(SceneError, match="'means' of shape"):
        read_splat(tmp_path / "wide.pt")
    del content["means"]
    torch.save(content, tmp_path / "less.pt")
    with pytest.raises(SceneError, match="no tensor 'means'"):
        read_splat(tmp_path / "less.pt")
    with zipfile.ZipFile(tmp_path / "packed.pt", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data.pkl", b"\0" * 100_000)
    with pytest.raises(SceneError, match="compressed"):
        read_splat(tmp_path / "packed.pt")


@pytest.mark.parametrize(
    ("odd", "said"),
    [("a/DATA.PKL", "member 'DATA.PKL'"), ("b/data/0", "members of several"), ("a/x", "'x'")],
)
def test_a_checkpoint_that_two_readers_may_read_as_two_is_refused(tmp_path, odd, said):
    torch.save(_checkpoint(cloud(4)), tmp_path / "a.pt")
    read_splat(tmp_path / "a.pt")
    with zipfile.ZipFile(tmp_path / "a.pt", "a") as archive:
        archive.writestr(odd, b"")
    with pytest.raises(SceneError, match=said):
        read_splat(tmp_path / "a.pt")


def test_a_nerfstudio_export_comes_back_in_the_frame_of_the_capture(tmp_path):
    gaussians = cloud(300)
    rotation = look_at((0, 0, 0), (1, 2, -0.5))[:3, :3]
    t, scale = np.array([0.3, -1.0, 2.0]), 0.37
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = scale * rotation, scale * t
    write_splat(tmp_path / "splat.ply", transformed(gaussians, T))
    transform = np.column_stack([rotation, t]).tolist()
    (tmp_path / "dataparser_transforms.json").write_text(
        json.dumps({"transform": transform, "scale": scale})
    )
    back = read_splat(tmp_path)
    assert np.abs(back.means - gaussians.means).max() < 1e-5
    assert np.abs(back.log_scales - gaussians.log_scales).max() < 1e-5
    assert _same_turn(back.quats, gaussians.quats) > 0.999999
    assert np.abs(back.sh - gaussians.sh).max() < 1e-5


def test_turned_harmonics_give_turned_colours():
    rotation = look_at((0, 0, 0), (1, 2, -0.5))[:3, :3]
    sh = cloud(20).sh
    d = np.random.default_rng(0).normal(size=(50, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    before = np.einsum("dk,nkc->ndc", harmonics(d), sh)
    after = np.einsum("dk,nkc->ndc", harmonics(d @ rotation.T), rotate_harmonics(sh, rotation))
    assert np.abs(before - after).max() < 1e-5


def test_harmonics_are_orthonormal_on_the_sphere():
    # Gauss-Legendre in z and equal steps in azimuth integrate degree 6 exactly.
    z, weight = np.polynomial.legendre.leggauss(8)
    azimuth = 2 * math.pi * np.arange(16) / 16
    z, azimuth = (a.reshape(-1) for a in np.meshgrid(z, azimuth, indexing="ij"))
    weight = np.repeat(weight, 16) * 2 * math.pi / 16
    r = np.sqrt(1 - z * z)
    values = harmonics(np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth), z]))
    assert np.abs((values * weight[:, None]).T @ values - np.eye(16)).max() < 1e-12


def test_spz_means_right_up_back(tmp_path):
    # A point at y = 1 (down in PLY axes) and z = 2 (front) is at -1 and -2 in SPZ axes.
    gaussians = cloud(1)
    gaussians.means[:] = [[0.5, 1.0, 2.0]]
    write_splat(tmp_path / "a.spz", gaussians)
    body = gzip.decompress((tmp_path / "a.spz").read_bytes())
    assert struct.unpack_from("<IIIBBBB", body) == (0x5053474E, 3, 1, 3, 12, 1, 0)
    fixed = [int.from_bytes(body[16 + 3 * i : 19 + 3 * i], "little", signed=True) for i in range(3)]
    assert fixed == [2048, -4096, -8192]


def test_a_picture_survives_spz(tmp_path):
    gaussians = cloud(3000)
    write_splat(tmp_path / "a.spz", gaussians)
    camera = Camera.from_fovy(
        width=64, height=48, fovy=1.0, T_world_camera=look_at((-4, -9, 1), (0.5, -1, 2))
    )
    a, b = (
        CpuRenderer(memory_store(g)).render(camera)
        for g in (gaussians, read_splat(tmp_path / "a.spz"))
    )
    assert a.alpha.max() > 0.5
    assert np.abs(a.rgb - b.rgb).mean() < 2e-3


def _spz(n=4, *, version=3, degree=0, bits=12, body=b""):
    head = struct.pack("<IIIBBBB", 0x5053474E, version, n, degree, bits, 0, 0)
    return gzip.compress(head + body)


_PROPERTY_X = b"property float x\nend_header\n"
BAD = {
    "empty.ply": (b"", "it is empty"),
    "text.ply": (b"ply\nformat ascii 1.0\nelement vertex 1\nend_header\n", "rows are said"),
    "endless.ply": (b"ply\n" + b"comment x\n" * 9000, "no end_header"),
    "points.ply": (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nend_header\n"
        + b"\0" * 4,
        "no property f_dc_0",
    ),
    "huge.ply": (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\n" + _PROPERTY_X,
        ":3: 999999999999 rows of 'vertex' in",
    ),
    "twice.ply": (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\n" + _PROPERTY_X,
        ":3: element vertex has a property twice",
    ),
    "odd.ply": (b"ply\nformat binary_little_endian 1.0\nelement vertex -1\nend_header\n", ":3: "),
    "cut.splat": (b"\0" * 33, "33 bytes"),
    "short.spz": (gzip.compress(b"x"), "header of 1 bytes"),
    "old.spz": (_spz(version=9), "version 9"),
    "deep.spz": (_spz(degree=7), "degree 7"),
    "less.spz": (_spz(body=b"\0" * 7), "4 Gaussians"),
    "more.spz": (_spz(body=b"\0" * 500), "4 Gaussians"),
    "bomb.spz": (_spz(n=1 << 31), "claim to expand"),
    "broken.spz": (b"\x1f\x8b" + b"\1" * 40, "gzip"),
    "v4.spz": (b"NGSP" + struct.pack("<II", 4, 4) + b"\0" * 30, "streams listed"),
    "a.pt": (b"PK\x03\x04" + b"\0" * 60, "archive"),
    "picture.jpg": (b"\xff\xd8\xff\xe0", "not a splat format"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_malformed_file_is_one_line_with_its_name_and_a_fix(tmp_path, name):
    data, message = BAD[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(SceneError) as caught:
        read_splat(tmp_path / name)
    text = str(caught.value)
    assert message in text
    assert name in text
    assert "; " in text
    assert "\n" not in text


def test_missing_files_and_folders_and_unknown_suffixes_say_so(tmp_path):
    with pytest.raises(SceneError, match="No such file"):
        read_splat(tmp_path / "none.ply")
    with pytest.raises(SceneError, match=r"0 \.ply files"):
        read_splat(tmp_path)
    with pytest.raises(UsageError, match=r"cannot write '\.spx'; did you mean '\.spz'"):
        write_splat(tmp_path / "a.spx", cloud(2))
    wide = cloud(2)
    wide.means[0] = 3000
    with pytest.raises(SceneError, match=r"within \+-2048, these reach 3000"):
        write_splat(tmp_path / "a.spz", wide)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"transform": 1, "scale": 1}', '{"transform": [[1]], "scale": -1}']
)
def test_a_nerfstudio_export_with_a_bad_transform_says_so(tmp_path, content):
    write_splat(tmp_path / "splat.ply", cloud(2))
    (tmp_path / "dataparser_transforms.json").write_text(content)
    with pytest.raises(SceneError, match=r"dataparser_transforms\.json"):
        read_splat(tmp_path)
