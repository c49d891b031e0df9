"""Splat files of the tools that write them: the same Gaussians as in the PLY that they were given.

`fixtures/written/cloud.ply` has 48 Gaussians of degree 3 (`splat_rooms.cloud(48, seed=7)`). The
other files were written from it: `st*` by splat-transform 2.7.1 (`st_sog.ply` is what it reads its
own `st.sog` as, degree 1), `spz*` by the library of nianticlabs/spz (21715c3), with an orbit
camera's record, the flag of antialiasing, or axes by their number in its header.
"""

import io
import json
import struct
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation
from splat_rooms import cloud

from nw_base.errors import SceneError
from nw_splat.camera import Camera, look_at
from nw_splat.files import compiled_store, files_of_splat, read_splat, write_splat
from nw_splat.files.spz import write_spz
from nw_splat.gaussians import concatenate, transformed
from nw_splat.render import CpuRenderer
from nw_splat.store import compile_store, memory_store, open_store, unpack

WRITTEN = Path(__file__).parent / "fixtures" / "written"
# File, what it says that it was trained for, and how coarse its harmonics are.
FILES = {
    "st_v3.spz": ("classic", 0.09),
    "st_v4.spz": ("classic", 0.09),
    "st.compressed.ply": (None, 0.02),
    "spz_v2_orbit_antialiased.spz": ("antialiased", 0.09),
    "spz_v3_axes8.spz": ("classic", 0.09),
    "spz_v4.spz": ("classic", 0.09),
    "spz_v4_axes3.spz": ("classic", 0.09),
    "spz_v4_axes6.spz": ("classic", 0.09),
    "spz_v4_axes10.spz": ("classic", 0.09),
    "spz_v4_axes12.spz": ("classic", 0.09),
}


def covariances(gaussians):
    """Of all Gaussians: turned or mirrored scales and rotations may say the same."""
    R = Rotation.from_quat(np.roll(gaussians.quats, -1, axis=1)).as_matrix()
    half = R * np.exp(gaussians.log_scales.astype(np.float64))[:, None]
    return half @ half.transpose(0, 2, 1)


def opacities(gaussians):
    return 1 / (1 + np.exp(-gaussians.opacity_logits.astype(np.float64)))


@pytest.mark.parametrize("file", FILES)
def test_each_writers_file_holds_the_gaussians_that_it_was_given(file):
    given, read = read_splat(WRITTEN / "cloud.ply"), read_splat(WRITTEN / file)
    mode, coarse = FILES[file]
    order = np.linalg.norm(given.means[:, None] - read.means[None], axis=2).argmin(axis=1)
    assert sorted(order.tolist()) == list(range(48))
    read = read.take(order)
    assert np.abs(read.means - given.means).max() < 5e-3
    assert np.abs(opacities(read) - opacities(given)).max() < 0.003
    assert np.abs(read.sh - given.sh).max() < coarse
    assert read.rasterize_mode == mode
    mine, theirs = covariances(read), covariances(given)
    assert np.abs(mine - theirs).max() < 0.07 * np.abs(theirs).max()


def test_a_sog_holds_what_its_own_writer_reads_in_it():
    read, theirs = read_splat(WRITTEN / "st.sog"), read_splat(WRITTEN / "st_sog.ply")
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        assert np.abs(getattr(read, name) - getattr(theirs, name)).max() < 1e-5, name
    assert read.sh_degree == 1


def test_the_files_of_a_sog_side_by_side_are_read_as_well(tmp_path):
    with zipfile.ZipFile(WRITTEN / "st.sog") as archive:
        archive.extractall(tmp_path)
    whole = read_splat(WRITTEN / "st.sog")
    for path in (tmp_path, tmp_path / "meta.json"):
        assert np.array_equal(read_splat(path).means, whole.means)


def _webp(pixels):
    """A lossless image of (n, 4) bytes, one row."""
    file = io.BytesIO()
    image = Image.fromarray(pixels[None].astype(np.uint8))
    image.save(file, "WEBP", lossless=True, exact=True)
    return file.getvalue()


def _sog_1(path, **changes):
    """Three Gaussians in SOG's first version, which has bounds in place of codebooks."""
    meta = {
        "means": {"shape": [3, 3], "mins": [0, 0, 0], "maxs": [1, 1, 1], "files": ["l", "u"]},
        "scales": {"mins": [-5, -5, -5], "maxs": [-1, -1, -1], "files": ["s"]},
        "quats": {"files": ["q"]},
        "sh0": {"mins": [-1, -1, -1, -4], "maxs": [1, 1, 1, 4], "files": ["c"]},
    } | changes
    grey = np.array([[0, 0, 0, 255], [128, 128, 128, 255], [255, 255, 255, 255]])
    middle = np.array([[128, 128, 128, 252], [128, 128, 128, 253], [128, 128, 128, 255]])
    opaque = np.array([[0, 0, 0, 0], [255, 0, 0, 255], [0, 255, 0, 51]])
    files = {"l": grey, "u": grey, "s": grey, "q": middle, "c": opaque}
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, pixels in files.items():
            archive.writestr(name, _webp(pixels))


def test_the_first_version_of_sog_is_read_by_its_bounds(tmp_path):
    _sog_1(tmp_path / "a.sog")
    read = read_splat(tmp_path / "a.sog")
    assert read.means[:, 0] == pytest.approx([0, np.expm1(32896 / 65535), np.e - 1], rel=1e-5)
    assert read.log_scales[:, 1] == pytest.approx([-5, -5 + 4 * 128 / 255, -1])
    assert read.quats.argmax(axis=1).tolist() == [0, 1, 3]
    assert read.opacity_logits == pytest.approx([-4, 4, -4 + 8 * 51 / 255])
    assert read.sh[:, 0] == pytest.approx(np.array([[-1, -1, -1], [1, -1, -1], [-1, 1, -1]]))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": 3}, "SOG version 3; versions 1 and 2 are read"),
        ({"means": {"shape": [900, 3], "files": ["l", "u"]}}, "l has 3 x 1 pixels|l has 3 pixels"),
        ({"means": {"shape": [10**9, 3]}}, "1000000000 Gaussians"),
        ({"means": {"shape": [10**7, 3]}}, "10000000 Gaussians in"),
        ({"quats": {"files": ["../../q"]}}, "no readable SOG"),
        ({"scales": {"mins": [0], "maxs": [1], "files": ["s"]}}, "scales has 1 bounds"),
    ],
)  # fmt: skip
def test_a_sog_that_cannot_be_read_says_why(tmp_path, changes, words):
    _sog_1(tmp_path / "a.sog", **changes)
    with pytest.raises(SceneError, match=words) as caught:
        read_splat(tmp_path / "a.sog")
    assert "a.sog" in str(caught.value)


def test_records_of_extensions_that_are_cut_short_or_unheard_of(tmp_path):
    write_spz(tmp_path / "a.spz", cloud(5), version=4)
    raw = (tmp_path / "a.spz").read_bytes()
    plain = read_splat(tmp_path / "a.spz")

    def with_record(record):
        (table,) = struct.unpack_from("<I", raw, 16)
        head = bytearray(raw[:32])
        head[14] |= 2
        struct.pack_into("<I", head, 16, table + len(record))
        (tmp_path / "b.spz").write_bytes(bytes(head) + record + raw[32:])
        return read_splat(tmp_path / "b.spz")

    unknown = with_record(struct.pack("<III", 0x12345678, 4, 1))
    assert np.array_equal(unknown.means, plain.means)
    for record, words in (
        (struct.pack("<II", 0x12345678, 400), "claims 400 bytes"),
        (b"\0" * 5, "cut short"),
        (struct.pack("<III", 0xADBE0003, 4, 17), "its axes are number 17"),
    ):
        with pytest.raises(SceneError, match=words):
            with_record(record)


def _ranks(folder, shares):
    for rank, share in shares.items():
        write_splat(folder / "a.pt", share)
        (folder / "a.pt").rename(folder / f"ckpt_29999_rank{rank}.pt")


def test_all_ranks_of_a_step_are_read_together(tmp_path):
    shares = {rank: cloud(10 + rank, seed=rank) for rank in (0, 1, 10)}
    shares |= {rank: cloud(3, seed=rank) for rank in range(2, 10)}
    _ranks(tmp_path, shares)
    write_splat(tmp_path / "ckpt_6999_rank0.pt", cloud(5))
    whole = concatenate(*(shares[rank] for rank in range(11)))
    for rank in (0, 1, 10):
        read = read_splat(tmp_path / f"ckpt_29999_rank{rank}.pt")
        assert np.array_equal(read.means, whole.means)
    assert len(read_splat(tmp_path / "ckpt_6999_rank0.pt")) == 5
    assert len(files_of_splat(tmp_path / "ckpt_29999_rank3.pt")) == 11


def test_a_rank_that_is_missing_is_named(tmp_path):
    _ranks(tmp_path, {1: cloud(4), 3: cloud(4)})
    with pytest.raises(SceneError, match=r"ckpt_29999_rank0\.pt, ckpt_29999_rank2\.pt of the same"):
        read_splat(tmp_path / "ckpt_29999_rank1.pt")


def test_another_rank_is_another_splat_in_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    _ranks(tmp_path, {0: cloud(40)})
    alone = open_store(compiled_store(tmp_path / "ckpt_29999_rank0.pt"))
    _ranks(tmp_path, {1: cloud(30, seed=3)})
    both = open_store(compiled_store(tmp_path / "ckpt_29999_rank0.pt"))
    assert both.count > alone.count


def test_a_link_to_another_rank_outside_the_folder_is_not_followed(tmp_path):
    _ranks(tmp_path, {0: cloud(4)})
    (tmp_path / "scene").mkdir()
    write_splat(tmp_path / "scene" / "ckpt_29999_rank1.pt", cloud(4))
    (tmp_path / "scene" / "ckpt_29999_rank0.pt").symlink_to(tmp_path / "ckpt_29999_rank0.pt")
    with pytest.raises(SceneError, match="put the files of all ranks there"):
        read_splat(tmp_path / "scene" / "ckpt_29999_rank1.pt")


def _columns(path, names, rows=4, comment="a splat", after=b"", more=""):
    head = f"ply\nformat binary_little_endian 1.0\ncomment {comment}\nelement vertex {rows}\n"
    head += "".join(f"property float {name}\n" for name in names) + more + "end_header\n"
    values = np.random.default_rng(3).normal(size=(rows, len(names))).astype("<f4")
    path.write_bytes(head.encode() + values.tobytes() + after)
    return values


THREE = [*"xyz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
THREE += ["rot_0", "rot_1", "rot_2", "rot_3"]


def test_lists_behind_the_gaussians_and_ascii_are_read(tmp_path):
    after = struct.pack("<B2f", 2, 1, 2)
    more = "element camera 1\nproperty list uchar float params\n"
    values = _columns(tmp_path / "a.ply", THREE, after=after, more=more)
    assert np.array_equal(read_splat(tmp_path / "a.ply").means, values[:, :3])
    head = "ply\nformat ascii 1.0\nelement vertex 4\n"
    head += "".join(f"property float {name}\n" for name in THREE) + "end_header\n"
    rows = "\n".join(" ".join(map(repr, row)) for row in values.tolist())
    (tmp_path / "b.ply").write_text(head + rows + "\n")
    assert np.array_equal(read_splat(tmp_path / "b.ply").quats, values[:, 10:])


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda p: _columns(p / "a.ply", [n for n in THREE if n != "scale_2"]), "discs of 2DGS"),
        (lambda p: torch.save({"pipeline": {}}, p / "a.pt"), "nerfstudio.*ns-export"),
        (lambda p: (p / "a.ckpt").write_bytes(b"PK\3\4" + b"\0" * 60), "nerfstudio.*ns-export"),
        (lambda p: torch.save({"splats": {"features": torch.zeros(2, 32)}}, p / "a.pt"), "app_opt"),
        (
            lambda p: torch.save({"a": 1}, p / "a.pt", _use_new_zipfile_serialization=False),
            "a pickle, which is not read; load it with torch",
        ),
        (lambda p: (p / "a.ksplat").write_bytes(b"\0\1\0\0"), "GaussianSplats3D.*splat-transform"),
    ],
)
def test_what_is_not_read_is_refused_by_its_name(tmp_path, write, words):
    write(tmp_path)
    (path,) = tmp_path.iterdir()
    with pytest.raises(SceneError, match=words):
        read_splat(path)


def test_the_filter_of_mip_splatting_is_folded_into_scales_and_opacities(tmp_path):
    """As create_fused_ply of Mip-Splatting does it (gaussian_model.py), in float64."""
    values = _columns(tmp_path / "a.ply", [*THREE, "filter_3D"]).astype(np.float64)
    read = read_splat(tmp_path / "a.ply")
    variances = np.exp(values[:, 7:10]) ** 2
    fused = variances + values[:, 14:15] ** 2
    share = np.sqrt(variances.prod(axis=1) / fused.prod(axis=1))
    assert np.exp(read.log_scales) == pytest.approx(np.sqrt(fused), rel=1e-5)
    assert opacities(read) == pytest.approx(share / (1 + np.exp(-values[:, 6])), rel=1e-4)
    assert read.rasterize_mode == "antialiased"


MODES = {"SplatRenderMode: default": "classic", "SplatRenderMode: mip": "antialiased", "a": None}


@pytest.mark.parametrize("comment", MODES)
def test_a_comment_says_what_a_ply_was_trained_for(tmp_path, comment):
    _columns(tmp_path / "a.ply", THREE, comment=comment)
    assert read_splat(tmp_path / "a.ply").rasterize_mode == MODES[comment]


@pytest.mark.parametrize(
    ("comment", "projection"),
    [("SplatProjection=ray", "ray"), ("SplatProjection: EWA", "ewa"), ("SplatProjection=x", None)],
)
def test_a_comment_says_how_a_ply_became_pixels_in_training(tmp_path, comment, projection):
    _columns(tmp_path / "a.ply", THREE, comment=comment)
    assert read_splat(tmp_path / "a.ply").projection == projection


@pytest.mark.parametrize("mode", ["classic", "antialiased", None])
def test_the_mark_survives_files_stores_and_frames(tmp_path, mode):
    projection = {"classic": "ewa", "antialiased": "ray"}.get(mode)
    gaussians = replace(cloud(20), rasterize_mode=mode, projection=projection)
    write_splat(tmp_path / "a.ply", gaussians)
    assert read_splat(tmp_path / "a.ply").rasterize_mode == mode
    assert read_splat(tmp_path / "a.ply").projection == projection
    write_splat(tmp_path / "a.spz", gaussians)
    assert read_splat(tmp_path / "a.spz").rasterize_mode == (mode or "antialiased")
    compile_store(gaussians, tmp_path / "a.nwsplat")
    assert open_store(tmp_path / "a.nwsplat").rasterize_mode == mode
    assert open_store(tmp_path / "a.nwsplat").projection == projection
    assert read_splat(tmp_path / "a.nwsplat").rasterize_mode == mode
    assert transformed(gaussians.take(slice(3)), np.diag([2, 2, 2, 1.0])).rasterize_mode == mode


def reference(gaussians, camera, *, antialiased):
    """RGB over white in float64, by gsplat's formulas, one Gaussian after the other.

    Footprint J W S W' J' + 0.3 I; antialiased multiplies opacity by
    sqrt(max(0, det before / det after)); alpha is at most 0.999, at least 1/255.
    """
    from nw_splat.gaussians import harmonics

    held = unpack(memory_store(gaussians).layout)
    T = camera.T_camera_world
    points = held.means.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    light = np.ones((camera.height, camera.width))
    image = np.zeros((camera.height, camera.width, 3))
    for i in np.argsort(points[:, 2]):
        x, y, z = points[i]
        if z < 0.01:
            continue
        jacobian = np.array([[camera.fx / z, 0, -camera.fx * x / z**2],
                             [0, camera.fy / z, -camera.fy * y / z**2]])  # fmt: skip
        M = jacobian @ T[:3, :3]
        before = M @ held.covariances[i].astype(np.float64) @ M.T
        after = before + 0.3 * np.eye(2)
        opacity = float(held.opacities[i])
        if antialiased:
            opacity *= np.sqrt(max(0.0, np.linalg.det(before) / np.linalg.det(after)))
        a, b, c = np.linalg.inv(after)[[0, 0, 1], [0, 1, 1]]
        dx = columns - (camera.fx * x / z + camera.cx)
        dy = rows - (camera.fy * y / z + camera.cy)
        power = -0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy
        alpha = np.minimum(0.999, opacity * np.exp(power))
        alpha[alpha < 1 / 255] = 0
        view = held.means[i].astype(np.float64) - camera.T_world_camera[:3, 3]
        values = harmonics((view / np.linalg.norm(view))[None])[0, : held.sh.shape[1]]
        colour = np.maximum(0, 0.5 + values @ held.sh[i].astype(np.float64))
        image += (light * alpha)[..., None] * colour
        light *= 1 - alpha
    return image + light[..., None]


def psnr(a, b):
    return 10 * np.log10(1 / np.mean((a - b) ** 2))


def test_a_classic_splat_is_drawn_without_the_compensation_of_antialiased_ones():
    fine = cloud(1500, degree=1, seed=5)
    fine = replace(fine, log_scales=fine.log_scales - 2)
    camera = Camera.from_fovy(
        width=64, height=48, fovy=0.6, T_world_camera=look_at((-4, -14, 1), (0, 0, 0))
    )
    drawn = {
        mode: CpuRenderer(memory_store(replace(fine, rasterize_mode=mode))).render(camera).rgb
        for mode in ("classic", "antialiased", None)
    }
    assert psnr(drawn["classic"], reference(fine, camera, antialiased=False)) > 60
    assert psnr(drawn["antialiased"], reference(fine, camera, antialiased=True)) > 60
    assert psnr(drawn["classic"], drawn["antialiased"]) < 35
    assert np.array_equal(drawn[None], drawn["antialiased"])
