"""What is found along a trail: in a sound corridor nothing, in damaged ones the damage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from sample_corridor import box, corridor, gaussians_on

from nw_eval.survey import survey_scene


def found(scene, **options):
    return {finding.code: finding for finding in survey_scene(scene, **options).findings}


def test_a_sound_corridor_has_nothing_wrong_and_says_its_figures(place):
    seen = survey_scene(place())
    assert seen.findings == ()
    print(seen.ground, seen.feet, seen.views.disagreement, min(v.covered for v in seen.views.views), min(v.alpha for v in seen.views.views))


@pytest.mark.parametrize("shift", [(0.2, 0, 0), (0, 0.2, 0), (0, -0.2, 0), (0, 0, 0.2), (-.2,0,0),(0,0,-.2)])
def test_a_shifted(place, shift):
    T = np.eye(4)
    T[:3, 3] = shift
    f = found(replace(place(), T_world_splat=T))
    print(shift, *map(str, f.values()), sep="\n   ")


def test_half(place):
    means = gaussians_on(corridor())
    print(*map(str, found(place(means=means[means[:, 1] < 0])).values()), sep="\n   ")


def test_curtain(place):
    means = gaussians_on(corridor())
    y, z = np.random.default_rng(0).uniform((-0.4, 0), (0.4, 0.5), (4000, 2)).T
    curtain = np.column_stack([0 * y + 3.0, y, z])
    print(*map(str, found(place(means=np.concatenate([means, curtain]))).values()), sep="\n   ")

def floor_with_hole(x0,x1,y0,y1):
    return trimesh.util.concatenate([box((-1.5,-1,-.2),(x0,1,0)),box((x1,-1,-.2),(5.5,1,0)),box((x0,-1,-.2),(x1,y0,0)),box((x0,y1,-.2),(x1,1,0))])
@pytest.mark.parametrize("hole",[(3,3.9,-.45,.45),(3,3.3,-.1,.2),(3,3.06,-.03,.03),(3.,3.5,-1.,1.)])
def test_hole(place,hole):
    for task in ("stairs","gaps"):
        s=place(corridor(floor_with_hole(*hole)),splat=False,task=task)
        print(hole,task,*map(str, found(s).values()), sep="\n   ")
def test_thin(place):
    s=place(trimesh.util.concatenate([corridor(),box((2.8,-.6,.295),(3.4,.6,.3))]),splat=False)
    print(*map(str, found(s).values()), sep="\n   ")
def test_caps(place,cameras):
    for c in (cameras(.4),cameras(1.4),cameras(2.5),cameras(.4,1.5)):
        s=survey_scene(place(captures=c))
        print(*map(str,s.findings), sep="\n   ")
