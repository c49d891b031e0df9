"""How the pictures of a run were drawn, as run.json and reports say it."""

import pytest

from nw_base.files.shipped import available
from nw_eval import api
from nw_eval.engine.how import How
from nw_eval.engine.provenance import run_info
from nw_eval.reporting.tables.run import provenance_table
from nw_gate.results.run_folder import RunFolder

DISTORTED = """\
cameras:
  ego:
    intrinsics:
      {width: 64, height: 36, fx: 60.0, fy: 60.0, cx: 32.0, cy: 18.0,
       distortion: {model: fisheye, coefficients: [0.01, 0.0, 0.0, 0.0]}}
"""
STRAIGHT = DISTORTED.replace(
    ",\n       distortion: {model: fisheye, coefficients: [0.01, 0.0, 0.0, 0.0]}", ""
)


@pytest.mark.parametrize(
    ("cameras", "render", "said"),
    [
        ("", "", "cpu gsplat-1.5"),
        (STRAIGHT, "", "cpu gsplat-1.5"),
        (DISTORTED, "", "cpu gsplat-1.5; with distortion, along the ray: ego"),
        (
            DISTORTED,
            "render: {samples: 4}\n",
            "cpu gsplat-1.5, ewa, 4 samples; with distortion, along the ray: ego",
        ),
        (DISTORTED, "render: {projection: ray}\n", "cpu gsplat-1.5, ray, 1 sample"),
    ],
)
def test_cameras_with_distortion_are_named_where_the_suite_says_ewa(
    cameras, render, said, tmp_path
):
    card = (available("policies")["stand"] / "policy.yaml").read_text()
    (tmp_path / "policy.yaml").write_text(f"{card.rstrip()}\n{cameras}")
    suite = tmp_path / "suite.yaml"
    suite.write_text(
        f"nw-eval: 1\nname: one\nrobot: go1\npolicy: {tmp_path}\ntrials: 1\nseed: 7\n{render}"
        "episode: {duration: 0.02}\nrecord: none\nscenes: [flat/carpet_room]\n"
    )
    folder = RunFolder(path=tmp_path / "run")
    info = run_info(api.plan(suite), folder, How(in_process=True), workers=1)
    assert info.renderer == said
    assert ("renderer", said) in [tuple(row)[:2] for row in provenance_table(info).rows]
