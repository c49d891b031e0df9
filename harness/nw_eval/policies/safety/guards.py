"""Checks in front of operators that believe the sizes which they are given.

Torch's own layers ask first whether weights and inputs fit; these operators, called directly, read
outside their arguments' memory where they do not (torch 2.13 on a CPU). Each function here has an
operator's name and arguments, checks them, and calls it. An exported graph calls the functions as
Python; a script has them compiled into it in their TorchScript form.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor


def rnn_fits(
    input: Tensor,  # noqa: A002 - the operators' own name.
    hidden: list[Tensor],
    params: list[Tensor],
    gates: int,
    has_biases: bool,
    num_layers: int,
    bidirectional: bool,
    batch_first: bool,
) -> None:
    """Check that hidden states and weights of a recurrent layer fit each other and the input."""
    directions = 2 if bidirectional else 1
    each = 4 if has_biases else 2
    if input.dim() != 3 or num_layers < 1 or len(hidden) < 1 or hidden[0].dim() != 3:
        raise ValueError("a recurrent layer whose input or hidden state has no three axes")
    if len(params) != num_layers * directions * each:
        raise ValueError("a recurrent layer whose weights are too few or too many")
    size = hidden[0].size(2)
    batch = input.size(0 if batch_first else 1)
    shape = [num_layers * directions, batch, size]
    for state in hidden:
        if list(state.size()) != shape or state.dtype != input.dtype:
            raise ValueError("a recurrent layer whose hidden state does not fit")
    width = input.size(2)
    for layer in range(num_layers):
        for direction in range(directions):
            first = (layer * directions + direction) * each
            for k in range(each):
                weight = params[first + k]
                rows = [gates * size]
                if k < 2:
                    rows.append(width if k == 0 else size)
                if list(weight.size()) != rows or weight.dtype != input.dtype:
                    raise ValueError("a recurrent layer whose weights do not fit its input")
        width = directions * size


def lstm(
    input: Tensor,  # noqa: A002
    hx: list[Tensor],
    params: list[Tensor],
    has_biases: bool,
    num_layers: int,
    dropout: float,
    train: bool,
    bidirectional: bool,
    batch_first: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """`aten::lstm.input`, without projections."""
    if len(hx) != 2:
        raise ValueError("an LSTM needs a hidden and a cell state")
    rnn_fits(input, hx, params, 4, has_biases, num_layers, bidirectional, batch_first)
    return torch.ops.aten.lstm(
        input, hx, params, has_biases, num_layers, dropout, train, bidirectional, batch_first
    )


def gru(
    input: Tensor,  # noqa: A002
    hx: Tensor,
    params: list[Tensor],
    has_biases: bool,
    num_layers: int,
    dropout: float,
    train: bool,
    bidirectional: bool,
    batch_first: bool,
) -> tuple[Tensor, Tensor]:
    """`aten::gru.input`."""
    rnn_fits(input, [hx], params, 3, has_biases, num_layers, bidirectional, batch_first)
    return torch.ops.aten.gru(
        input, hx, params, has_biases, num_layers, dropout, train, bidirectional, batch_first
    )


def never(name: str) -> Tensor:
    """Stand for an operator that a script may name where it does not get to, and never runs."""
    raise ValueError(f"the script calls `{name}`, which is not among the operators that may run")


def never_bool(name: str) -> bool:
    """The same for one that returns a bool."""
    raise ValueError(f"the script calls `{name}`, which is not among the operators that may run")


def never_two(name: str) -> tuple[Tensor, Tensor]:
    """The same for one that returns two tensors."""
    raise ValueError(f"the script calls `{name}`, which is not among the operators that may run")


def never_three(name: str) -> tuple[Tensor, Tensor, Tensor]:
    """The same for one that returns three."""
    raise ValueError(f"the script calls `{name}`, which is not among the operators that may run")


def cell_fits(
    input: Tensor,  # noqa: A002
    hidden: list[Tensor],
    weights: list[Tensor],
    biases: list[Tensor | None],
    gates: int,
) -> None:
    """Check the same of a single step of a recurrent layer."""
    if input.dim() != 2 or len(hidden) < 1 or hidden[0].dim() != 2:
        raise ValueError("a recurrent cell whose input or hidden state has no two axes")
    size = hidden[0].size(1)
    for state in hidden:
        if list(state.size()) != [input.size(0), size]:
            raise ValueError("a recurrent cell whose hidden state does not fit")
    rows = gates * size
    widths = [input.size(1), size]
    for k in range(2):
        if list(weights[k].size()) != [rows, widths[k]]:
            raise ValueError("a recurrent cell whose weights do not fit its input")
    for bias in biases:
        if bias is not None and list(bias.size()) != [rows]:
            raise ValueError("a recurrent cell whose biases do not fit its weights")


def lstm_cell(
    input: Tensor,  # noqa: A002
    hx: list[Tensor],
    w_ih: Tensor,
    w_hh: Tensor,
    b_ih: Tensor | None = None,
    b_hh: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """`aten::lstm_cell`."""
    if len(hx) != 2:
        raise ValueError("an LSTM needs a hidden and a cell state")
    cell_fits(input, hx, [w_ih, w_hh], [b_ih, b_hh], 4)
    return torch.ops.aten.lstm_cell(input, hx, w_ih, w_hh, b_ih, b_hh)


def gru_cell(
    input: Tensor,  # noqa: A002
    hx: Tensor,
    w_ih: Tensor,
    w_hh: Tensor,
    b_ih: Tensor | None = None,
    b_hh: Tensor | None = None,
) -> Tensor:
    """`aten::gru_cell`."""
    cell_fits(input, [hx], [w_ih, w_hh], [b_ih, b_hh], 3)
    return torch.ops.aten.gru_cell(input, hx, w_ih, w_hh, b_ih, b_hh)


def mask_fits(mask: Tensor, query: Tensor, keys: int) -> None:
    """Check that the mask of an attention may be spread over its scores."""
    scores = list(query.size())
    scores[-1] = keys
    if mask.dim() > len(scores):
        raise ValueError("attention whose mask has too many axes")
    for axis in range(1, mask.dim() + 1):
        if mask.size(-axis) not in (1, scores[-axis]):
            raise ValueError("attention whose mask does not fit its scores")


def attention_fits(
    query: Tensor, key: Tensor, value: Tensor, mask: Tensor | None, shared_heads: bool
) -> None:
    """Check that queries, keys and values have one batch, as many keys as values, one width."""
    axes = query.dim()
    if axes < 2 or key.dim() != axes or value.dim() != axes:
        raise ValueError("attention whose query, key and value differ in their number of axes")
    if query.numel() * key.numel() * value.numel() == 0:
        raise ValueError("attention of nothing")
    for axis in range(axes - 2):
        many, few = query.size(axis), key.size(axis)
        shared = shared_heads and axis == axes - 3 and many % few == 0
        if value.size(axis) != few or (many != few and not shared):
            raise ValueError("attention whose query, key and value differ in batch or heads")
    if key.size(-2) != value.size(-2) or query.size(-1) != key.size(-1):
        raise ValueError("attention whose query, key and value do not fit each other")
    if key.dtype != query.dtype or value.dtype != query.dtype:
        raise ValueError("attention whose query, key and value differ in dtype")
    if mask is not None:
        mask_fits(mask, query, key.size(-2))


def scaled_dot_product_attention(
    query: Tensor,
    key: Tensor,
    value: Tensor,
    attn_mask: Tensor | None = None,
    dropout_p: float = 0.0,
    is_causal: bool = False,
    scale: float | None = None,
    enable_gqa: bool = False,
) -> Tensor:
    """`aten::scaled_dot_product_attention`; batches are not broadcast."""
    attention_fits(query, key, value, attn_mask, enable_gqa)
    return torch.ops.aten.scaled_dot_product_attention(
        query, key, value, attn_mask, dropout_p, is_causal, scale=scale, enable_gqa=enable_gqa
    )


def _scaled_dot_product_flash_attention_for_cpu(
    query: Tensor,
    key: Tensor,
    value: Tensor,
    dropout_p: float = 0.0,
    is_causal: bool = False,
    attn_mask: Tensor | None = None,
    scale: float | None = None,
) -> tuple[Tensor, Tensor]:
    """The same as an exported graph calls it."""
    attention_fits(query, key, value, attn_mask, True)
    if query.dim() != 4 or value.size(3) != query.size(3):
        raise ValueError("attention whose query, key and value do not fit each other")
    return torch.ops.aten._scaled_dot_product_flash_attention_for_cpu(  # noqa: SLF001 - its name.
        query, key, value, dropout_p, is_causal, attn_mask=attn_mask, scale=scale
    )


def _native_batch_norm_legit_no_training(
    input: Tensor,  # noqa: A002
    weight: Tensor | None,
    bias: Tensor | None,
    running_mean: Tensor,
    running_var: Tensor,
    momentum: float,
    eps: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """Batch normalisation as an exported graph calls it: one number of each a channel."""
    if input.dim() < 2:
        raise ValueError("a batch normalisation of something without channels")
    for part in [weight, bias, running_mean, running_var]:
        if part is not None and list(part.size()) != [input.size(1)]:
            raise ValueError("a batch normalisation whose numbers do not fit its channels")
    return torch.ops.aten._native_batch_norm_legit_no_training(  # noqa: SLF001 - its name.
        input, weight, bias, running_mean, running_var, momentum, eps
    )


GUARDED: dict[str, Callable[..., Any]] = {
    "gru.input": gru,
    "gru_cell.default": gru_cell,
    "lstm.input": lstm,
    "lstm_cell.default": lstm_cell,
    "scaled_dot_product_attention.default": scaled_dot_product_attention,
    "_native_batch_norm_legit_no_training.default": _native_batch_norm_legit_no_training,
    "_scaled_dot_product_flash_attention_for_cpu.default": (
        _scaled_dot_product_flash_attention_for_cpu
    ),
}
"""The functions by the operators, with their overloads, that they stand in front of."""


@functools.cache
def guards_code() -> str:
    """Return the functions above in the language of TorchScript files."""
    with warnings.catch_warnings():
        # torch recommends torch.export for new files; the ones that people have are scripts.
        warnings.simplefilter("ignore", DeprecationWarning)
        checks: tuple[Any, ...] = (rnn_fits, cell_fits, mask_fits, attention_fits)
        refusals: tuple[Any, ...] = (never, never_bool, never_two, never_three)
        functions = (*checks, *refusals, *GUARDED.values())
        scripted: list[Any] = [torch.jit.script(function) for function in functions]
    return "".join(function.code for function in scripted)
