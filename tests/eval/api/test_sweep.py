"""A sweep from suite to picture, with policies that walk and stand."""

import pyarrow.parquet as pq
import pytest
from PIL import Image

from nw_base.errors import UsageError
from nw_eval import api
from nw_gate.results.request import Request

SUITE = """\
nw-eval: 1
name: slippery
robot: go1
policy: go1-parkour
trials: 3
seed: 5
scenes: [hurdles/one_low_carpet]
episode: {duration: 6.0}
perturb: {payload: [2.0]}
gate: {success_rate: 0.9}
"""


@pytest.fixture
def suite(tmp_path):
    path = tmp_path / "slippery.yaml"
    path.write_text(SUITE)
    return path


def test_a_sweep_walks_two_policies_along_an_axis_and_writes_what_it_found(suite, tmp_path):
    out = tmp_path / "sweep"
    found = api.sweep(
        Request(suite=suite), ["friction=0.05,1.25"], baseline="stand", out=out, workers=1
    )
    ((walker, stander),) = found.axes
    assert (walker.policy, stander.policy) == ("go1-parkour", "stand")
    assert [point.value for point in walker.points] == [0.05, 1.25]
    assert [point.trials for point in walker.points] == [3, 3]
    assert walker.points[0].share < walker.points[1].share == 1.0
    assert stander.points[1].share == 0.0
    with Image.open(out / "sweep.png") as picture:
        assert min(picture.size) > 300
    rows = pq.read_table(out / "sweep.parquet").to_pylist()
    assert [(row["policy"], row["value"], row["completed"]) for row in rows][1::2] == [
        ("go1-parkour", 1.25, 3),
        ("stand", 1.25, 0),
    ]
    page = (out / "sweep.md").read_text()
    assert "stand: nothing to fall from: none of 3 trials at friction 1.25 completed" in page
    assert "![Success by axis](sweep.png)" in page
    runs = {row.perturbation for row in api.judge(out / "friction" / "1", baseline="none").rows}
    assert runs == {(("friction", 0.05),), (("friction", 1.25),)}, "the suite's own is left out"


def test_a_sweep_that_cannot_be_run_runs_nothing(suite, tmp_path):
    with pytest.raises(UsageError, match="no axis to sweep"):
        api.sweep(Request(suite=suite), [], out=tmp_path / "out")
    with pytest.raises(UsageError, match="an axis is given twice"):
        api.sweep(Request(suite=suite), ["push=0,1", "push=0,2"], out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    with pytest.raises(UsageError, match="full is not empty"):
        api.sweep(Request(suite=suite), ["push=0,1"], out=tmp_path / "full")
