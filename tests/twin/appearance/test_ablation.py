"""What mesh and depths are worth, measured on views that no training saw."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from small_capture import photos

from nw_base.errors import SceneError, UsageError
from nw_twin.building.ablation import ARMS, TrainedArm, ablate, table_text
from nw_twin.building.appearance import AppearanceOptions, AppearanceReport, split_photos
from nw_twin.building.folder import BuildFolder
from nw_twin.capture import read_capture
from nw_twin.gaussians.loss import ViewFigures


def outcome(arm, psnrs, low=None):
    views = tuple(
        ViewFigures(name=f"{number}.png", psnr=psnr - 1, psnr_corrected=psnr, ssim=0.9)
        for number, psnr in enumerate(psnrs)
    )
    return TrainedArm(
        arm=arm, report=AppearanceReport(gaussians=7, photos=20, views=views), low=low
    )


def cells(text, line):
    return [cell.strip() for cell in text.splitlines()[2 + line].strip("|").split("|")]


def test_differences_are_taken_view_by_view_with_students_interval():
    first, other = [20.0, 24.0, 30.0, 22.0], [21.0, 24.5, 30.2, 23.5]
    text = table_text([outcome(ARMS[0], first), outcome(ARMS[3], other)])
    found = scipy.stats.ttest_rel(other, first)
    interval = found.confidence_interval(0.95)
    assert cells(text, 0)[4] == ""
    assert cells(text, 1)[4] == f"+0.80 ({interval.low:+.2f} to {interval.high:+.2f})"
    assert cells(text, 1)[:4] == ["mesh", "yes", "7", f"{np.mean(other):.2f}"]


def test_views_from_a_robots_height_are_counted_apart_where_heights_are_known():
    low = frozenset({"0.png", "3.png", "not-held-out.png"})
    text = table_text([outcome(ARMS[0], [20.0, 24.0, 30.0, 23.0], low=low)])
    assert cells(text, 0)[6] == "21.50"
    assert "on the 2 of them from below 0.6 m" in text
    assert cells(table_text([outcome(ARMS[0], [20.0, 24.0])]), 0)[6] == ""


def test_photographs_that_are_named_are_held_out_and_no_others():
    named = [named_photo(f"{kind}_{number}.png") for kind in ("low", "high") for number in "12"]
    learnt, held = split_photos(tuple(named), AppearanceOptions(held_out="low_*"))
    assert [photo.name for photo in held] == ["low_1.png", "low_2.png"]
    assert [photo.name for photo in learnt] == ["high_1.png", "high_2.png"]
    for name, count in (("nothing*", 0), ("*", 4)):
        with pytest.raises(UsageError, match=f"holds out {count} of 4 photographs"):
            split_photos(tuple(named), AppearanceOptions(held_out=name))


def named_photo(name):
    return replace(photos(1)[0], name=name)


@pytest.mark.nightly
def test_all_four_ways_are_trained_once_and_compared_on_the_same_views(build, tmp_path):
    shutil.copytree(build, tmp_path / "build")
    folder = BuildFolder(tmp_path)
    lines = []
    options = AppearanceOptions(
        iterations=40, longest=48, begin=500, most=667, held_out_every=4, strategy="fixed"
    )
    with pytest.raises(SceneError, match="no result of `reconstruct`"):
        ablate(folder, options, lines.append)
    for stage in ("calibrate", "reconstruct"):
        folder.carry_out(stage, [], lambda: None, lines.append)
    trained = ablate(folder, options, lines.append)
    points = len(read_capture(folder.capture).points)
    counts = [each.report.gaussians for each in trained]
    assert counts[:2] == [points, points]
    assert 500 <= counts[2] == counts[3] <= 667
    assert {tuple(v.name for v in each.report.views) for each in trained} == {("02.png", "06.png")}
    assert len({each.report.psnr for each in trained}) == 4
    assert not any("resumes" in line for line in lines)
    again = ablate(folder, options, lines.append)
    assert sum("resumes after step 40 of 40" in line for line in lines) == 4
    assert table_text(again) == table_text(trained)
    with pytest.raises(UsageError, match="nothing to compare on"):
        ablate(folder, replace(options, held_out_every=0), lines.append)
