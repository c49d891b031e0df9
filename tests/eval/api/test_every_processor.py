"""Results of nw-eval's networks are of one class on all processors."""

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import nw_eval
from nw_eval import api
from nw_eval.engine.identity import engine_of
from nw_gate.results.baseline import machine_in, machine_of
from nw_gate.results.baseline_file import read_baseline
from nw_gate.results.provenance import read_run_info
from nw_policies import load_bundle
from nw_policies.executor import IDENTITY
from nw_policies.networks.onnx_graph import Graph

POLICIES = Path(nw_eval.__file__).parents[2] / "policies"
SUMMING = """\
nw-policy: 1
name: summing
robot: go1
adapter: onnx
checkpoint: {{file: policy.onnx, sha256: {digest}}}
control: {{action: joint_position_offset, scale: 0.25}}
observations:
  proprio: {{sensor: proprio, layout: parkour53}}
"""
"""A card whose file has an operator that nw-eval does not run."""
SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: policy
trials: 2
seed: 5
episode: {duration: 0.04}
scenes: [flat/carpet_room]
record: none
gate: {max_drop: 0.2, baseline: go1-parkour, rounds: 2, least_starts: 1}
"""


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project with a policy of one runtime, without a cache of trials."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NW_EVAL_CACHE_GB", "0")

    def make(runtime=None):
        shutil.copytree(POLICIES / "go1-parkour", "policy")
        card = Path("policy/policy.yaml")
        text = card.read_text(encoding="utf-8")
        line = f"adapter: onnx\nruntime: {runtime}\n" if runtime else "adapter: onnx\n"
        card.write_text(text.replace("adapter: onnx\n", line, 1))
        Path("quick.yaml").write_text(SUITE)
        return load_bundle("policy")

    return make


@pytest.fixture
def processor(monkeypatch):
    """Let this machine have a processor of some name."""

    def choose(name):
        monkeypatch.setattr("nw_eval.engine.identity.cpu_kind", lambda: name)

    return choose


@pytest.mark.parametrize("runtime", [None, pytest.param("native", marks=pytest.mark.nightly)])
def test_a_baseline_of_one_processor_holds_on_another_where_nw_eval_runs_the_networks(
    runtime, project, processor
):
    project(runtime)
    processor("zen 0a0a0a0a")
    baseline = read_baseline(api.save_baseline("quick.yaml", trials=4, workers=1).file)
    processor("emerald 1b1b1b1b")
    ran = api.run("quick.yaml", workers=1)
    run = read_run_info(ran.folder / "run.json")
    holds = runtime is None
    # Where it holds, its rows are taken over, and no trial of its policy has to run beside others.
    assert (baseline.panel_of(machine_of(run)) is not None) == holds
    assert ("cpu" in run.engine) != holds
    sentence = "" if holds else "its results depend on the processor: ONNX Runtime"
    assert run.policy.dependence == sentence
    report = (ran.folder / "report.md").read_text(encoding="utf-8")
    assert ("its results depend on the processor" in report) != holds


def test_the_class_of_nw_eval_s_networks_names_neither_processor_nor_runtimes(project, processor):
    card = project("nw-eval").card
    processor("zen 0a0a0a0a")
    here = machine_in(engine_of("cpu", (), card))
    processor("emerald 1b1b1b1b")
    assert machine_in(engine_of("cpu", (), card)) == here
    assert here["networks"] == IDENTITY == "nw-eval networks 1"
    assert here.keys() == {"numpy", "numba", "code", "networks", "architecture"}


def test_the_class_of_other_runtimes_is_what_it_was(project, processor):
    card = project("native").card
    processor("zen 0a0a0a0a")
    here = engine_of("cpu", (), card)
    assert here == engine_of("cpu")
    assert here["cpu"] == "zen 0a0a0a0a"
    assert {"onnxruntime", "torch"} <= here.keys()
    assert not {"networks", "architecture"} & here.keys()


@pytest.mark.nightly
def test_a_baseline_of_nw_eval_s_networks_has_one_class_whatever_saved_it(project, processor):
    project("nw-eval")
    processor("zen 0a0a0a0a")
    file = api.save_baseline("quick.yaml", trials=2, workers=1).file
    processor("emerald 1b1b1b1b")
    assert api.save_baseline("quick.yaml", trials=2, workers=1).action == "unchanged"
    (panel,) = read_baseline(file).panels
    assert "cpu" not in panel.machine


@pytest.fixture
def summing(project):
    """The project's policy, with a file that sums up."""
    project()
    graph, rng = Graph(), np.random.default_rng(2)
    matrix = graph.constant(rng.normal(0, 0.1, (53, 12)).astype(np.float32))
    product = graph.node("MatMul", graph.input("obs", 1, 53), matrix)
    data = graph.model(graph.node("CumSum", product, graph.constant(np.array(1))), 1, 12)
    folder = Path("policy")
    for file in folder.iterdir():
        file.unlink()
    (folder / "policy.onnx").write_bytes(data)
    (folder / "policy.yaml").write_text(SUMMING.format(digest=hashlib.sha256(data).hexdigest()))
    return folder


def test_a_policy_with_another_operator_goes_to_its_own_runtime_and_the_run_says_which(summing):
    ran = api.run("quick.yaml", workers=1, baseline="none")
    run = read_run_info(ran.folder / "run.json")
    assert run.policy.dependence == "its results depend on the processor: operator CumSum"
    assert {"cpu", "onnxruntime"} <= run.engine.keys()
    assert run.policy.card_digest == load_bundle(summing).digest
    log = next((ran.folder / "mcap").rglob("*.mcap"))
    assert api.replay(log).is_identical
    assert api.replay(log).versions == ()


@pytest.mark.usefixtures("summing")
def test_without_that_runtime_the_operator_and_the_extra_are_named():
    code = """
import sys
sys.modules["onnxruntime"] = None
from nw_base.errors import PrerequisiteError
from nw_policies import load_bundle, open_policy
try:
    open_policy(load_bundle("policy"))
except PrerequisiteError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert "nw-eval does not run operator CumSum, and the package onnxruntime is not" in done.stdout
    assert done.stdout.endswith("; pip install 'nw-eval[onnxruntime]'\n")


def test_a_command_without_torch_names_the_extra(tmp_path):
    code = """
import sys
sys.modules["torch"] = None
from nw_eval.cli import main
main(["train", "teacher", "teacher-smoke", "--out", "out"])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, check=False, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "error: the package torch is not installed; pip install 'nw-eval[" in done.stderr
