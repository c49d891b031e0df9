"""Rules as in `aten` for layers that torch runs as one operator: recurrent ones, and attention.

The order of gates is torch's and ONNX's: LSTM i, f, g, o and i, o, f, g; GRU r, z, n and z, r, n.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from torch.nn import functional

from nw_policies.executor import UnsupportedError
from nw_policies.networks.aten import rule

if TYPE_CHECKING:
    from nw_policies.networks.values import Values

_GATES = {"lstm": (0, 3, 1, 2), "gru": (1, 0, 2), "rnn": (0,)}


@rule("lstm", "gru", "rnn_tanh", "rnn_relu")
def _recurrent(r: Values, a: Any, _: Any) -> list[str]:
    if a.get("batch_sizes") is not None or (a.train and a.dropout):
        raise UnsupportedError("sequences of several lengths, or dropout")
    is_lstm, turns = a.operator == "lstm", 1 + bool(a.bidirectional)
    x = r.name(a.input)
    steps, batch = a.input.shape[:2]
    if a.batch_first:
        steps, batch = batch, steps
        x = r.add("Transpose", x, perm=[1, 0, 2])
    before = list(a.hx) if is_lstm else [a.hx]
    each = len(a.params) // (a.num_layers * turns)
    lasts: list[tuple[str, ...]] = []
    for layer in range(a.num_layers):
        at = layer * turns
        weights = [a.params[(at + turn) * each : (at + turn + 1) * each] for turn in range(turns)]
        states = [r.slice(r.name(state), 0, at, at + turns) for state in before]
        size = before[0].shape[2]
        y, *last = _layer(r, a.operator, x, weights, states, size=size)
        y = r.add("Transpose", y, perm=[0, 2, 1, 3])
        x = r.reshaped(y, [steps, batch, turns * size])
        lasts.append(tuple(last))
    y = r.add("Transpose", x, perm=[1, 0, 2]) if a.batch_first else x
    ends = [_joined(r, [last[place] for last in lasts]) for place in range(len(before))]
    return [y, *ends]


def _joined(r: Values, names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else r.add("Concat", *names, axis=0)


def _layer(
    r: Values,
    operator: str,
    x: str,
    weights: Any,
    states: Sequence[str],
    *,
    size: int,
) -> tuple[str, ...]:
    """Return the outputs and last states of one layer; `weights` for each of its directions."""
    kind = operator.partition("_")[0]
    order = _GATES[kind]
    gates = [
        [np.concatenate([np.split(r.array(w), len(order))[g] for g in order]) for w in one]
        for one in weights
    ]
    stacked = [np.stack([one[place] for one in gates]) for place in range(2)]
    zeros = np.zeros((len(gates), 2 * len(order) * size), np.float32)
    bias = np.stack([np.concatenate(one[2:4]) for one in gates]) if len(gates[0]) > 2 else zeros
    at: dict[str, Any] = {"hidden_size": size}
    at |= {"linear_before_reset": 1} if kind == "gru" else {}
    at |= {"direction": b"bidirectional"} if len(gates) == 2 else {}
    at |= {"activations": [b"Relu"] * len(gates)} if operator == "rnn_relu" else {}
    constants = [r.graph.constant(each) for each in (*stacked, bias)]
    return r.graph.add_many(
        {"lstm": "LSTM", "gru": "GRU", "rnn": "RNN"}[kind], x, *constants, "", *states,
        outputs=1 + len(states), **at,
    )  # fmt: skip


@rule("lstm_cell", "gru_cell", "rnn_tanh_cell", "rnn_relu_cell")
def _cell(r: Values, a: Any, _: Any) -> list[str]:
    before = list(a.hx) if a.operator == "lstm_cell" else [a.hx]
    batch, size = before[0].shape
    weights = [w for w in (a.w_ih, a.w_hh, a.b_ih, a.b_hh) if w is not None]
    _, *last = _layer(
        r, a.operator.removesuffix("_cell"), r.reshaped(r.name(a.input), [1, *a.input.shape]),
        [weights], [r.reshaped(r.name(state), [1, batch, size]) for state in before],
        size=size,
    )  # fmt: skip
    return [r.reshaped(each, [batch, size]) for each in last]


def _heads(query: Any, key: Any, value: Any, a: Any) -> Any:
    """Return multi-head attention, (batch, tokens, width)."""
    if a.mask is not None:
        raise UnsupportedError("a mask")
    parts = zip((query, key, value), a.qkv_weight.chunk(3), a.qkv_bias.chunk(3), strict=True)
    heads = a.get("num_head", a.get("num_heads"))
    q, k, v = (
        functional.linear(x, w, b).unflatten(2, (heads, -1)).transpose(1, 2) for x, w, b in parts
    )
    attended = functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)
    return functional.linear(attended, a.proj_weight, a.proj_bias)


def _attention_layer(a: Any) -> Any:
    if a.need_weights:
        raise UnsupportedError("`need_weights`")
    return _heads(a.query, a.key, a.value, a), None


def _encoder_layer(a: Any) -> Any:
    def normed(x: Any, weight: Any, bias: Any) -> Any:
        return functional.layer_norm(x, (a.embed_dim,), weight, bias, a.eps)

    first, second = (a.norm_weight_1, a.norm_bias_1), (a.norm_weight_2, a.norm_bias_2)
    activation = functional.gelu if a.use_gelu else functional.relu

    def fed(x: Any) -> Any:
        inner = activation(functional.linear(x, a.ffn_weight_1, a.ffn_bias_1))
        return functional.linear(inner, a.ffn_weight_2, a.ffn_bias_2)

    x = a.src
    if a.norm_first:
        h = normed(x, *first)
        x = x + _heads(h, h, h, a)
        return x + fed(normed(x, *second))
    x = normed(x + _heads(x, x, x, a), *first)
    return normed(x + fed(x), *second)


COMPOSED: dict[str, Callable[[Any], Any]] = {
    "_native_multi_head_attention": _attention_layer,
    "_transformer_encoder_layer_fwd": _encoder_layer,
}
"""By operator, a function of its arguments that torch runs in place of it, and is recorded."""
