"""A policy that walks out of what was photographed: real rollouts in scene folders with a splat."""

import json
from pathlib import Path

import numpy as np
import pytest

from nw_base.errors import IncomparableError
from nw_eval import api
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.results.parquet import read_rows
from nw_gate.settings import Validity
from nw_gate.stats.betting import lower_bound
from nw_scenes.capture_file import write_captures
from nw_sim.catalogue import get_scene
from nw_splat.files import write_splat
from nw_splat.gaussians import Gaussians

pytestmark = (
    pytest.mark.nightly
)  # real workers; by day tests/sim/rollout and tests/gate show as much

SCENE = """\
nw-scene: 1
name: {name}
task: hurdles
licence: MIT
trail: [[0.8, 0, 0], [2.2, 0, 0]]
collision: boxes.json
splat: splat.ply
captures: captures.json
"""
SUITE = """\
nw-eval: 1
name: fog
robot: go1
policy: ./sees
trials: 1
seed: 5
episode: {{duration: 8.0}}
scenes: [./all, ./half]
record: none
gate: {{success_rate: 0.005{more}}}
"""
VALIDITY = "validity: {distance: 0.6, angle: 0.8, at_most: 0.6}"
AHEAD = (0.5, -0.5, 0.5, -0.5)  # x right, y down, z ahead along the world's x


def gaussians():
    rng = np.random.default_rng(3)
    count = 300
    return Gaussians(
        means=rng.uniform((0.5, -3.0, 0.0), (8.0, 3.0, 2.0), (count, 3)),
        log_scales=np.full((count, 3), np.log(0.3)),
        quats=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        opacity_logits=np.full(count, 2.0),
        sh=rng.uniform(-1.0, 1.0, (count, 1, 3)),
    )


def write_policy(folder):
    """The shipped policy with eyes, which it opens and does not look through."""
    onnx = pytest.importorskip("onnx")
    shipped = Path(__file__).parents[3] / "policies" / "go1-parkour"
    model = onnx.load(str(shipped / "policy.onnx"))
    (walks,) = model.graph.input
    eyes = onnx.helper.make_tensor_value_info("rgb", onnx.TensorProto.UINT8, [1, 24, 40, 3])
    model.graph.input.append(eyes)
    folder.mkdir()
    onnx.save(model, str(folder / "policy.onnx"))
    card = (shipped / "policy.yaml").read_text()
    card = "".join(line for line in card.splitlines(keepends=True) if "sha256" not in line)
    names = "[proprio, scandots, last_output, history]"
    card += "  rgb: {sensor: splat_rgb, camera: ego, width: 40, height: 24, rate: 10}\n"
    card += f"\ninputs: {{{walks.name}: {names}, rgb: [rgb]}}\n"
    (folder / "policy.yaml").write_text(card)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with two scenes, photographed all along and half of the way, and a policy."""
    folder = tmp_path_factory.mktemp("fog")
    for name, reach in (("all", 3.0), ("half", 0.8)):
        scene = folder / name
        scene.mkdir()
        (scene / "scene.yaml").write_text(SCENE.format(name=name))
        floor = {"center": [2, 3, 0.05], "half_size": [0.1, 0.1, 0.05]}
        (scene / "boxes.json").write_text(json.dumps({"boxes": [floor]}))
        write_splat(scene / "splat.ply", gaussians())
        cameras = [((x, 0.0, 0.3), AHEAD) for x in np.arange(0.0, reach, 0.2)]
        write_captures(scene / "captures.json", cameras)
    write_policy(folder / "sees")
    return folder


@pytest.fixture(scope="module")
def ran(place):
    (place / "fog.yaml").write_text(SUITE.format(more=f", {VALIDITY}"))
    return api.run(place / "fog.yaml", out=place / "run", workers=1)


@pytest.fixture(scope="module")
def rows(ran):
    return read_rows(ran.folder / "trials.parquet")[0]


def test_one_that_leaves_is_counted_apart_and_neither_passes_nor_fails(ran, rows):
    verdict = ran.verdict
    assert verdict.left == {row.trial_id for row in rows if row.scene == "half"}
    photographed, half = verdict.per_scene
    assert (photographed.n, photographed.outside, photographed.missing) == (1, 0, 0)
    assert (half.n, half.outside, half.missing) == (0, 1, 0)
    assert verdict.success == 1.0
    # One of two may have been a failure: it counts as one.
    assert verdict.verdict == "PASS"
    assert verdict.interval.low == lower_bound([np.ones(1), np.zeros(1)])
    assert any(
        "1 trial left the captured volume for longer than 0.5 s" in r for r in verdict.reasons
    )


def test_the_row_has_the_way_of_the_camera_tenth_by_tenth(rows):
    half = next(row for row in rows if row.scene == "half")
    tenths = len(half.capture_distance)
    assert tenths == len(half.capture_angle) == len(half.capture_alpha)
    assert tenths == pytest.approx(10 * half.sim_s, abs=1.0)
    # It walks along x, past the last camera at 0.6 m, until 0.3 m before the waypoint at 2.2 m;
    # its eye is 0.27 m ahead of the trunk.
    assert half.completed
    assert 1.3 < half.capture_distance[-1] < 1.8
    assert half.capture_distance[0] < 0.3
    assert max(half.capture_angle) < np.pi / 2
    assert min(half.capture_alpha) == np.float32(half.coverage_min)
    assert np.mean(half.capture_alpha) == pytest.approx(half.coverage_mean, abs=0.02)


def test_over_the_cap_nothing_is_judged_and_the_report_says_what_to_do(rows):
    gate = Gate(success_rate=0.005, validity=Validity(distance=0.6, at_most=0.4))
    verdict = judge(rows, gate, {"all": 1, "half": 1})
    assert (verdict.verdict, verdict.exit_code) == ("INCONCLUSIVE", 3)
    assert verdict.reasons[0].startswith("1 of 2 trials left the captured volume, over")
    assert "capture more of the scene from the robot's height" in verdict.reasons[0]


def test_the_report_and_junit_count_them_apart(ran):
    page = (ran.folder / "report.md").read_text()
    assert "Left the captured volume" in page
    assert "1 left the captured volume" in page.splitlines()[0]
    xml = (ran.folder / "report.html").read_text()
    assert "Left the captured volume" in xml


def test_without_the_key_the_same_rows_pass_as_they_always_did(ran, place):
    (place / "clear.yaml").write_text(SUITE.format(more=""))
    bare = api.run(place / "clear.yaml", out=place / "clear", workers=1)
    info = json.loads((bare.folder / "run.json").read_text())
    assert info["rows_digest"] == json.loads((ran.folder / "run.json").read_text())["rows_digest"]
    assert "validity" not in info["suite"]["gate"]
    assert not bare.verdict.left
    assert bare.verdict.interval.low == lower_bound([np.ones(1), np.ones(1)])
    assert not any("captured volume" in reason for reason in bare.verdict.reasons)


def test_other_capture_cameras_make_another_scene(place):
    first = get_scene(place / "half")
    assert first.digest != get_scene(place / "all").digest


def test_a_run_over_the_cap_makes_no_baseline(ran, place):
    (place / "strict.yaml").write_text(
        SUITE.format(more=f", {VALIDITY}").replace("at_most: 0.6", "at_most: 0.4")
    )
    strict = api.run(place / "strict.yaml", out=place / "strict", workers=1)
    assert strict.exit_code == 3
    with pytest.raises(IncomparableError, match="1 of 2 trials left the captured volume"):
        api.save_baseline(place / "strict.yaml", run=strict.folder, root=place / "baselines")
    api.save_baseline(place / "fog.yaml", run=ran.folder, root=place / "baselines")


def test_verify_finds_the_same_numbers_again(ran):
    assert api.verify(ran.folder, trials="1").exit_code == 0
