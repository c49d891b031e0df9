"""From a capture on disk to a splat file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from small_capture import PLACE
from splat_rooms import psnr

from nw_base.errors import SceneError, UsageError
from nw_splat.files import read_splat
from nw_splat.gaussians import SH0
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store
from nw_twin.building import appearance as the_stage
from nw_twin.building.appearance import (
    AppearanceOptions,
    photos_of,
    points_of,
    points_on,
    split_photos,
    train_splat,
)
from nw_twin.capture import read_capture
from nw_twin.gaussians.rasteriser import Rasteriser

QUICK = AppearanceOptions(
    iterations=120, longest=72, begin=700, most=933, held_out_every=4, strategy="fixed"
)


def trained(build, out, options=QUICK, mesh=True):
    lines = []
    report = train_splat(
        build / "capture", build / "mesh" if mesh else None, out, options, lines.append
    )
    return report, lines


def test_a_splat_of_a_capture_shows_photographs_that_it_never_saw(build, tmp_path):
    few, _ = trained(build, tmp_path / "few", replace(QUICK, iterations=1))
    report, lines = trained(build, tmp_path / "out")
    assert (report.photos, len(report.views)) == (6, 2)
    assert report.psnr > few.psnr + 2.0
    splat = read_splat(tmp_path / "out" / "splat.ply")
    assert 700 < len(splat) == report.gaussians < 933  # The balls' tops lie off the mesh.
    # What photographs see above the floor's horizon is far away, and white as the background is.
    sky = splat.take(np.linalg.norm(splat.means, axis=1) > 50.0)
    assert 30 < len(sky) < 75
    assert 0.5 + SH0 * sky.sh[:, 0] == pytest.approx(1.0, abs=0.15)
    assert 0.01 < report.sky < 0.1
    assert (splat.rasterize_mode, splat.projection) == ("antialiased", "ray")
    facts = json.loads((tmp_path / "out" / "report.json").read_text())
    assert facts["psnr"] == pytest.approx(report.psnr)
    assert facts["options"]["iterations"] == 120
    assert lines[-1] == (
        f"splat: {len(splat)} Gaussians of 6 photographs, "
        f"{report.psnr:.1f} dB on 2 photographs kept from it"
    )


def test_the_file_is_drawn_along_the_ray_as_the_training_saw_it(build, tmp_path):
    trained(build, tmp_path)
    splat = read_splat(tmp_path / "splat.ply")
    photo = photos_of(read_capture(build / "capture"), build / "capture", None, longest=72)[0]
    shipped = CpuRenderer(memory_store(splat), projection="ray").render(photo.camera).rgb
    assert psnr((shipped, Rasteriser().render(splat, photo.camera).rgb.transpose(1, 2, 0))) > 75.0


def test_a_training_that_was_cut_off_ends_in_the_same_bytes(build, tmp_path, monkeypatch):
    trained(build, tmp_path / "whole")
    monkeypatch.setattr(the_stage, "_KEEP_EVERY", 0.0)
    steps = iter(range(40))
    step = the_stage.Trainer.step

    def cut(trainer):
        if next(steps, None) is None:
            raise KeyboardInterrupt
        return step(trainer)

    monkeypatch.setattr(the_stage.Trainer, "step", cut)
    with pytest.raises(KeyboardInterrupt):
        trained(build, tmp_path / "cut")
    monkeypatch.setattr(the_stage.Trainer, "step", step)
    assert not (tmp_path / "cut" / "splat.ply").exists()
    _, lines = trained(build, tmp_path / "cut")
    assert lines[1] == "splat: resumes after step 40 of 120"
    whole, again = (tmp_path / n / "splat.ply" for n in ("whole", "cut"))
    assert whole.read_bytes() == again.read_bytes()


def test_of_few_photographs_some_are_held_out_until_the_figures_are_taken(build, tmp_path):
    options = replace(QUICK, held_out_every=8)
    report, lines = trained(build, tmp_path, options)
    assert [view.name for view in report.views] == ["04.png"]
    assert (report.photos, report.learnt_after) == (8, True)
    facts = json.loads((tmp_path / "report.json").read_text())
    assert facts["learnt_after"] is True
    assert facts["ssim"] == pytest.approx(report.ssim)
    assert lines[-1].endswith(f"{report.psnr:.1f} dB on 1 photograph before it learnt from it")
    # The figures are of the training without it, and the splat of all.
    without, _ = trained(build, tmp_path / "named", replace(options, held_out="04.png"))
    assert (without.views, without.photos, without.learnt_after) == (report.views, 7, False)
    splat = (tmp_path / "splat.ply").read_bytes()
    assert splat != (tmp_path / "named" / "splat.ply").read_bytes()
    _, lines = trained(build, tmp_path, options)
    assert [line for line in lines if "resumes" in line] == [
        "splat: resumes after step 120 of 120",
        "splat: resumes after step 24 of 24",
    ]
    assert (tmp_path / "splat.ply").read_bytes() == splat


@pytest.mark.parametrize(
    ("count", "held"),
    [(3, []), (4, [2]), (8, [4]), (12, [3, 9]), (14, [3, 10]), (16, [4, 12]), (24, [4, 12, 20])],
)
def test_about_every_eighth_photograph_is_held_out(build, count, held):
    capture = read_capture(build / "capture")
    photo = photos_of(capture, build / "capture", None, longest=36)[0]
    photos = tuple(replace(photo, name=str(number)) for number in range(count))
    learnt, out = split_photos(photos, AppearanceOptions())
    assert [int(each.name) for each in out] == held
    assert len(learnt) == count - len(held)


def test_a_state_of_other_options_is_begun_anew(build, tmp_path):
    options = replace(QUICK, iterations=5)
    trained(build, tmp_path, options)
    _, lines = trained(build, tmp_path, replace(options, seed=3))
    assert "from the beginning" in lines[1]


def test_without_a_mesh_it_begins_at_the_points_of_the_calibration(build, tmp_path):
    options = replace(QUICK, iterations=1, depth=False)
    report, _ = trained(build, tmp_path, options, mesh=False)
    assert report.gaussians == len(PLACE.means[::10])


def test_pictures_are_reduced_with_their_cameras_and_depths(build):
    capture = read_capture(build / "capture")
    whole = photos_of(capture, build / "capture", build / "mesh" / "depth", longest=72)
    half = photos_of(capture, build / "capture", build / "mesh" / "depth", longest=36)
    for large, small in zip(whole, half, strict=True):
        assert small.rgb.shape == (24, 36, 3)
        assert small.camera.fx == pytest.approx(large.camera.fx / 2)
        assert small.camera.cx == pytest.approx(large.camera.cx / 2)
        block = large.rgb.astype(float).reshape(24, 2, 36, 2, 3).mean((1, 3))
        assert np.abs(small.rgb - block).max() <= 1.0  # Pillow rounds after each axis.
        assert set(small.inverse_depth.ravel()) <= set(large.inverse_depth.ravel())


def coloured(path, *boxes):
    mesh = trimesh.util.concatenate(boxes)
    mesh.visual.vertex_colors = np.tile([120, 110, 90, 255], (len(mesh.vertices), 1))
    mesh.export(path)
    return path


def test_points_lie_on_the_mesh_with_its_colours_and_normals(tmp_path):
    path = coloured(tmp_path / "mesh.ply", trimesh.creation.box((8.3, 8.3, 0.02)))
    eyes = np.array([[0.0, 0.0, 1e4]])
    points, colours, normals = points_on(path, 4000, eyes, seed=1)
    assert np.abs(points[:, 2]).max() <= 0.0101
    top = points[normals[:, 2] > 0.99]
    assert (top[:, 2] > 0.0099).all()
    assert (top[:, 0] < 0).mean() == pytest.approx(0.5, abs=0.03)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    np.testing.assert_allclose(colours * 255, np.tile([120, 110, 90], (4000, 1)), atol=0.01)


def test_points_lie_densely_where_photographs_were_taken_from_near(tmp_path):
    near, far = trimesh.creation.box((1, 1, 0.01)), trimesh.creation.box((1, 1, 0.01))
    near.apply_translation((0, 0, -2.0))
    far.apply_translation((0, 0, -6.0))
    path = coloured(tmp_path / "mesh.ply", near, far)
    points, _, _ = points_on(path, 4000, np.zeros((1, 3)), seed=1)
    count = (points[:, 2] > -4.0).sum() / (points[:, 2] < -4.0).sum()
    assert count == pytest.approx(9.0, rel=0.1)


def test_of_points_beside_a_mesh_those_count_that_clearly_lie_off_it(build):
    capture = read_capture(build / "capture")
    floor = capture.points[capture.points[:, 2] < 0.01]
    off, colours = points_of(capture, off=floor + np.array([0.05, 0.0, 0.0]))
    assert len(off) == len(colours) == (capture.points[:, 2] > 0.01).sum()
    assert off[:, 2].min() > 0.01
    assert len(points_of(capture)[0]) == len(capture.points)


@pytest.mark.parametrize("damage", ["gone", "other arrays", "pickled"])
def test_a_damaged_depth_is_named(build, tmp_path, damage):
    capture = read_capture(build / "capture")
    path = tmp_path / "00.png.npz"
    if damage == "other arrays":
        np.savez(path, depths=np.ones((2, 2)))
    if damage == "pickled":
        np.savez(path, depth=np.array([{}]), confidence=np.ones((2, 2)))
    with pytest.raises(SceneError, match=r"00\.png\.npz holds no depth"):
        photos_of(capture, build / "capture", tmp_path, longest=72)


@pytest.mark.parametrize("wrong", [{"iterations": 0}, {"held_out_every": 1}, {"longest": 8}])
def test_options_that_make_no_sense_are_refused(wrong):
    with pytest.raises(UsageError, match=next(iter(wrong))):
        AppearanceOptions(**wrong)
