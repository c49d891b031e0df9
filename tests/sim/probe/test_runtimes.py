"""What a check says of a policy by its own runtime and by nw-eval."""

from __future__ import annotations

import numpy as np
import pytest

from nw_eval.cli.verbs.policies import probe_page
from nw_policies import load_bundle
from nw_policies.networks.onnx_graph import Graph
from nw_sim.probe.recording import record
from nw_sim.probe.report import FLAT, probe_here
from nw_sim.probe.runtimes import TOLERANCE, compare_runtimes, runtime_findings

CARD = """\
nw-policy: 1
name: mine
robot: go1
adapter: onnx
{runtime}
checkpoint: {{file: policy.onnx}}
control: {{action: joint_position_offset, scale: 0.25}}
observations:
  proprio: {{sensor: proprio, layout: parkour53}}
"""


def summed(graph, x):
    """The sums of all numbers up to each."""
    return graph.node("CumSum", x, graph.constant(np.array(1)))


def chaotic(graph, x):
    """Numbers of which the last digits of an input decide the first."""
    large = graph.constant(np.full((1, 12), 1e6, np.float32))
    return graph.node("Sin", graph.node("Mul", graph.node("Sigmoid", x), large))


def plain(graph, x):
    return graph.node("Sigmoid", x)


@pytest.fixture
def bundle(tmp_path):
    """Return a maker of bundles with a perceptron and one more operator."""

    def make(last, runtime=None):
        graph, rng = Graph(), np.random.default_rng(2)
        matrix = graph.constant(rng.normal(0, 0.1, (53, 12)).astype(np.float32))
        y = last(graph, graph.node("MatMul", graph.input("obs", 1, 53), matrix))
        (tmp_path / "policy.onnx").write_bytes(graph.model(y, 1, 12))
        (tmp_path / "policy.yaml").write_text(
            CARD.format(runtime=f"runtime: {runtime}" if runtime else "")
        )
        return load_bundle(tmp_path)

    return make


def compared(bundle):
    return compare_runtimes(bundle, record(bundle, scene=FLAT, seconds=0.1))


def test_a_network_that_nw_eval_runs_differs_by_rounding_and_what_it_depends_on_is_said(bundle):
    found = compared(bundle(plain, "native"))
    assert found.output == "action"
    assert 0 < found.difference < 1e-5
    assert found.text.startswith("its results depend on the processor: ONNX Runtime; between")
    assert "`action` differs by at most" in found.text
    assert not list(runtime_findings(bundle(plain), found))
    ours = compared(bundle(plain))
    assert ours.text.startswith("its networks give the same results on every processor; between")
    assert ours.difference == found.difference


def test_an_operator_that_nw_eval_does_not_run_is_what_results_depend_on(bundle):
    found = compared(bundle(summed))
    assert found.depends_on == "operator CumSum"
    assert found.difference is None
    assert "its results depend on the processor: operator CumSum (not compared" in found.text


@pytest.mark.parametrize(
    ("runtime", "kind"), [("native", "note"), ("nw-eval", "fault"), (None, "fault")]
)
def test_a_difference_beyond_rounding_is_no_secret(runtime, kind, bundle):
    one = bundle(chaotic, runtime)
    found = compared(one)
    assert found.difference > TOLERANCE
    (finding,) = runtime_findings(one, found)
    assert finding.kind == kind
    assert "`action` differs by" in finding.text


def test_the_page_of_a_check_has_the_sentence(bundle):
    page = probe_page(probe_here(bundle(plain), scene="ramps/one_ramp_plaza"))
    (line,) = [line for line in page.splitlines() if line.startswith("processor: ")]
    assert "its networks give the same results on every processor" in line


def test_an_output_that_is_no_number_is_the_one_that_differs_most(monkeypatch):
    given = {
        "native": {"action": np.ones((2, 3)), "code": np.ones((2, 3))},
        "nw-eval": {"action": np.ones((2, 3)) + 1e-7, "code": np.full((2, 3), np.nan)},
    }
    monkeypatch.setattr(
        "nw_sim.probe.runtimes._run",
        lambda _bundle, runtime, _recording: given[runtime],
    )
    bundle = load_bundle("go1-parkour")
    found = compare_runtimes(bundle, None)
    assert found.output == "code"
    assert found.difference > TOLERANCE
    assert [each.kind for each in runtime_findings(bundle, found)] == ["fault"]
    given["native"] = given["nw-eval"]  # Both give none.
    assert compare_runtimes(bundle, None).difference == 0.0
