"""Recurrent layers: LSTM, GRU and RNN of ONNX, step by step, made of products and activations.

Formulas and the order of gates are those of https://onnx.ai/onnx/operators (LSTM-22, GRU-22,
RNN-22): LSTM input, output, forget, cell; GRU update, reset, hidden.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_policies.executor import program as rows
from nw_policies.executor.graph import Node, UnsupportedError
from nw_policies.executor.moves import joined, part
from nw_policies.executor.planning import Array, Planner, operator
from nw_policies.executor.views import View

_STEPS = 256
_DEFAULTS = {
    "LSTM": [b"sigmoid", b"tanh", b"tanh"],
    "GRU": [b"sigmoid", b"tanh"],
    "RNN": [b"tanh"],
}
_GATES = {"LSTM": 4, "GRU": 3, "RNN": 1}
_CODES = {b"sigmoid": rows.SIGMOID, b"tanh": rows.TANH, b"relu": rows.RELU}


@operator("LSTM", "GRU", "RNN")
def _recurrent(plan: Planner, node: Node) -> None:
    at, kind = node.attributes, node.operator
    x = plan.view(node.inputs[0])
    if at.get("layout"):
        raise UnsupportedError("layout 1")
    steps, batch, _ = x.shape
    weights, hidden = (plan.constant(name).astype(np.float32) for name in node.inputs[1:3])
    directions, size = weights.shape[0], hidden.shape[2]
    turns = {b"forward": [False], b"reverse": [True], b"bidirectional": [False, True]}
    reversed_ = turns[at.get("direction", b"forward")]
    names = [name.lower() for name in at.get("activations", _DEFAULTS[kind] * directions)]
    if steps > _STEPS or plan.has(node, 4) or at.get("clip") or at.get("input_forget"):
        raise UnsupportedError(f"{steps} steps, lengths of sequences, a clip or coupled gates")
    if plan.has(node, 7) or any(name not in _CODES for name in names):
        raise UnsupportedError("peepholes or other activations")
    biases = plan.constant_or(node, 3, np.zeros((directions, 2 * _GATES[kind] * size)))
    outputs: list[View] = []
    lasts: list[tuple[View, ...]] = []
    for number, is_reversed in enumerate(reversed_):
        before = [
            _initial(plan, node, place, number, (batch, size))
            for place in ((5, 6) if kind == "LSTM" else (5,))
        ]
        cell = _Cell(
            plan,
            kind,
            weights[number],
            hidden[number],
            biases[number].astype(np.float32),
            [_CODES[n] for n in names[number * len(_DEFAULTS[kind]) :]],
            linear_before_reset=bool(at.get("linear_before_reset")),
        )
        state = tuple(before)
        made: dict[int, View] = {}
        order = range(steps - 1, -1, -1) if is_reversed else range(steps)
        for step in order:
            one = plan.reshaped(part(x, 0, step, 1), x.shape[1:])
            state = cell.step(one, state)
            made[step] = plan.reshaped(state[0], (1, 1, batch, size))
        outputs.append(joined(plan, [made[step] for step in range(steps)], 0))
        lasts.append(state)
    results = [joined(plan, outputs, 1)]
    for place in range(len(lasts[0])):
        each = [plan.reshaped(last[place], (1, batch, size)) for last in lasts]
        results.append(joined(plan, each, 0))
    for name, result in zip(node.outputs, results, strict=False):
        if name:
            plan.values[name] = result


def _initial(plan: Planner, node: Node, index: int, number: int, shape: tuple[int, int]) -> View:
    if not plan.has(node, index):
        return plan.scalar(0.0).broadcast(shape)
    return plan.reshaped(part(plan.view(node.inputs[index]), 0, number, 1), shape)


class _Cell:
    """One direction of a layer."""

    def __init__(
        self, plan: Planner, kind: str, weights: Array, hidden: Array, biases: Array, codes: Any,
        *, linear_before_reset: bool,
    ) -> None:  # fmt: skip
        self._plan = plan
        self._kind = kind
        self._weights, self._hidden = weights.T, hidden.T
        self._given, self._kept = np.split(biases, 2)
        self._codes = codes
        self._size = hidden.shape[1]
        self._linear_before_reset = linear_before_reset

    def step(self, x: View, state: tuple[View, ...]) -> tuple[View, ...]:
        """Return the next state: hidden, and for an LSTM cell."""
        match self._kind:
            case "LSTM":
                return self._lstm(x, *state)
            case "GRU":
                return (self._gru(x, *state),)
            case _:
                plan = self._plan
                given, kept = self._products(x, state[0])
                return (plan.apply(self._codes[0], plan.combine(rows.ADD, given, kept)),)

    def _products(self, x: View, hidden: View) -> tuple[View, View]:
        plan = self._plan
        hidden = plan.dense(hidden)
        given = plan.product("", x, self._weights, self._given)
        return given, plan.product("", hidden, self._hidden, self._kept)

    def _gate(self, view: View, number: int) -> View:
        return part(view, 1, number * self._size, self._size)

    def _lstm(self, x: View, hidden: View, cell: View) -> tuple[View, ...]:
        plan, (gate, candidate, squash) = self._plan, self._codes[:3]
        both = plan.combine(rows.ADD, *self._products(x, hidden))
        i, o, f = (plan.apply(gate, self._gate(both, number)) for number in range(3))
        c = plan.apply(candidate, self._gate(both, 3))
        kept = plan.combine(rows.MUL, f, cell)
        after = plan.combine(rows.ADD, kept, plan.combine(rows.MUL, i, c))
        return plan.combine(rows.MUL, o, plan.apply(squash, after)), after

    def _gru(self, x: View, hidden: View) -> View:
        plan, (gate, candidate) = self._plan, self._codes[:2]
        given, kept = self._products(x, hidden)
        z, r = (
            plan.apply(gate, plan.combine(rows.ADD, self._gate(given, n), self._gate(kept, n)))
            for n in (0, 1)
        )
        if self._linear_before_reset:
            recalled = plan.combine(rows.MUL, r, self._gate(kept, 2))
        else:
            columns = slice(2 * self._size, 3 * self._size)
            reset = plan.combine(rows.MUL, r, hidden)
            recalled = plan.product("", reset, self._hidden[:, columns], self._kept[columns])
        h = plan.apply(candidate, plan.combine(rows.ADD, self._gate(given, 2), recalled))
        new = plan.combine(rows.MUL, plan.combine(rows.SUB, plan.scalar(1.0), z), h)
        return plan.combine(rows.ADD, new, plan.combine(rows.MUL, z, hidden))
