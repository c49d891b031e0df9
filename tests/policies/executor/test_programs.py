"""Programs are data: what a check passes stays in its arena; what it refuses is never run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import onnx
import onnxruntime
import pytest

from nw_policies.executor import Program, planning
from nw_policies.executor.joining import Link, joined, moved
from nw_policies.executor.network import Network
from nw_policies.executor.plan import plan
from nw_policies.executor.program import (
    COPY,
    ELEMENTS,
    OFFSETS,
    PRODUCT,
    SCALED,
    WIDTH,
    touched,
)

GUARD = 4096


def guarded(program):
    """Run a program in an arena between two guards, and return whether they are as they were."""
    from nw_policies.executor.kernels import run

    arena = np.full(program.arena + 2 * GUARD, 7.0, np.float32)
    inner = arena[GUARD:-GUARD]
    inner[:] = 0.0
    inner[: program.numbers.size] = program.numbers
    for rows in (program.once, program.rows):
        run(inner, np.ascontiguousarray(rows), program.scratch)
    return bool((arena[:GUARD] == 7.0).all() and (arena[-GUARD:] == 7.0).all())


def test_a_program_survives_the_way_through_bytes(perceptron, graph_of):
    program = plan(graph_of(perceptron))
    again = Program.unpacked(program.packed())
    x = np.random.default_rng(2).normal(0, 1, (1, 48)).astype(np.float32)
    first, second = (Network(each)({"obs": x})["action"].copy() for each in (program, again))
    assert first.tobytes() == second.tobytes()


def test_a_network_is_near_to_onnxruntime_s(perceptron, graph_of):
    network = Network(plan(graph_of(perceptron)))
    session = onnxruntime.InferenceSession(perceptron.SerializeToString())
    for seed in range(10):
        x = np.random.default_rng(seed).normal(0, 1, (1, 48)).astype(np.float32)
        np.testing.assert_allclose(
            network({"obs": x})["action"], session.run(None, {"obs": x})[0], rtol=1e-4, atol=1e-5
        )


@pytest.fixture
def pair(perceptron, graph_of):
    """A perceptron, and another one whose input begins with what the first one gives."""
    one, other = plan(graph_of(perceptron)), plan(graph_of(perceptron))
    return joined((one, other), (Link(0, "action", 1, "obs", first=5),))[0]


@pytest.mark.parametrize("model", ["perceptron", "eye", "pair"])
def test_no_mutant_that_passes_the_check_touches_anything_outside(model, request, graph_of):
    found = request.getfixturevalue(model)
    if isinstance(found, Program):
        program = found
    else:
        program = plan(graph_of(found() if callable(found) else found))
    rng = np.random.default_rng(3)
    passed = 0
    for _ in range(3000):
        rows = program.rows.copy()
        for _ in range(rng.integers(1, 4)):
            place = rng.integers(len(rows)), rng.integers(rows.shape[1])
            kind = rng.integers(4)
            rows[place] = (
                rng.integers(-5, 12)
                if kind == 0
                else rng.integers(-program.arena, 2 * program.arena)
                if kind == 1
                else rows[place] + rng.integers(-40, 40)
                if kind == 2
                else rng.choice([2**31, 2**62, -(2**62), 2**63 - 1])
            )
        mutant = replace(program, rows=rows)
        try:
            mutant.check()
        except ValueError:
            continue
        passed += 1
        assert guarded(mutant)
    assert passed > 50


def test_joined_programs_give_what_they_give_apart(pair, perceptron, graph_of):
    alone, both = Network(plan(graph_of(perceptron))), Network(pair)
    rng = np.random.default_rng(8)
    first, rest = (rng.normal(0, 1, (1, 48)).astype(np.float32) for _ in range(2))
    given = alone({"obs": first})["action"].copy()
    found = both({"0 obs": first, "1 obs": rest})
    assert found["0 action"].tobytes() == given.tobytes()
    rest[0, 5:17] = given
    assert found["1 action"].tobytes() == alone({"obs": rest})["action"].tobytes()


def test_a_moved_row_touches_what_it_touched_so_much_later(perceptron, eye, graph_of):
    known = [plan(graph_of(model)).rows for model in (perceptron, eye())]
    rng = np.random.default_rng(9)
    every = rng.integers(0, 9, (len(OFFSETS), WIDTH))
    every[:, 0], every[:, 1], every[:, [9, 17]], every[:, 13] = range(len(OFFSETS)), 0, 1, 0
    every[:, 21] = 0
    for row in np.concatenate([*known, every]):
        (other,) = moved(row[np.newaxis], 100)
        before, after = (list(touched(one.tolist())) for one in (row, other))
        assert after == [(offset + 100, extents) for offset, extents in before]


@pytest.mark.parametrize(("first", "said"), [(-1, "from -1 on"), (40, "12 numbers from 40 on, of")])
def test_what_does_not_fit_into_an_input_is_not_linked(perceptron, graph_of, first, said):
    one, other = plan(graph_of(perceptron)), plan(graph_of(perceptron))
    with pytest.raises(ValueError, match=said):
        joined((one, other), (Link(0, "action", 1, "obs", first=first),))


@pytest.mark.parametrize(
    ("also", "mean", "operations"),
    [
        ((), None, [SCALED, PRODUCT, COPY]),
        ((), np.float32([0.5]), [SCALED, PRODUCT, COPY]),
        ((), np.linspace(0, 1, 30, dtype=np.float32), [ELEMENTS, ELEMENTS, COPY, PRODUCT, COPY]),
        (("centred",), None, [SCALED, COPY, PRODUCT, COPY]),
        (("share",), None, [ELEMENTS, ELEMENTS, PRODUCT, COPY]),
        (("squared",), None, [ELEMENTS, ELEMENTS, PRODUCT, ELEMENTS, COPY]),
        (("squared", "centred"), None, [ELEMENTS, ELEMENTS, COPY, PRODUCT, ELEMENTS, COPY]),
    ],
)
def test_rows_are_one_where_nothing_else_takes_what_is_between(
    eye, graph_of, monkeypatch, also, mean, operations
):
    model = eye(*also, mean=mean)
    program = plan(graph_of(model))
    assert program.rows[:, 0].tolist() == operations
    monkeypatch.setattr(planning, "fused", lambda program, _kept: program)
    apart = plan(graph_of(model))
    assert len(apart.rows) == 5 + ("squared" in also)
    rgb = np.random.default_rng(7).integers(0, 256, (1, 3, 20, 30)).astype(np.uint8)
    for name, array in Network(apart)({"rgb": rgb}).items():
        assert array.tobytes() == Network(program)({"rgb": rgb})[name].tobytes()


def test_bytes_that_are_no_program_are_refused(perceptron, graph_of):
    data = plan(graph_of(perceptron)).packed()
    rng = np.random.default_rng(4)
    for _ in range(300):
        damaged = bytearray(data)
        damaged[rng.integers(min(len(damaged), 4000))] = rng.integers(256)
        try:
            found = Program.unpacked(bytes(damaged))
        except ValueError:
            continue
        assert guarded(found)
    for cut in (0, 3, 100, len(data) - 4):
        with pytest.raises(ValueError, match=r"program|buffer|Expecting|Unterminated|version"):
            Program.unpacked(data[:cut])


def test_an_input_of_another_shape_is_refused(perceptron, graph_of):
    network = Network(plan(graph_of(perceptron)))
    with pytest.raises(ValueError, match=r"`obs` has the shape \(1, 1\), not \(1, 48\)"):
        network({"obs": np.zeros((1, 1), np.float32)})


def test_a_graph_is_read_as_the_onnx_package_reads_it(perceptron, graph_of):
    graph = graph_of(perceptron)
    for tensor in perceptron.graph.initializer:
        assert np.array_equal(graph.constants[tensor.name], onnx.numpy_helper.to_array(tensor))
    assert [node.operator for node in graph.nodes] == ["Gemm", "Elu", "Gemm"]
