"""Puts the tensors of a file into a network, and says in plain words what does not fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import TypeVar

import torch
from torch import nn

from nw_base.errors import PolicyError, nearest

Network = TypeVar("Network", bound=nn.Module)


def build(
    make: Callable[[], Network],
    tensors: Mapping[str, torch.Tensor],
    where: str,
    *,
    unused: Sequence[str] = (),
) -> Network:
    """Make a network and give it its tensors.

    Args:
        make: makes the network; called without memory and without random numbers.
        tensors: by the names of the network's own state dict.
        where: path of the file, for errors.
        unused: words in the names of tensors that inference does not need: they may be missing,
            or have other shapes, and are left out.

    Returns:
        The network in evaluation mode, all numbers float32.

    Raises:
        PolicyError: names or shapes differ; all differences in one message.
    """
    with torch.device("meta"):
        network = make()
    needed = {
        name: tensor
        for name, tensor in network.state_dict().items()
        if not any(word in name for word in unused)
    }
    saved = {
        name: tensor for name, tensor in tensors.items() if not any(word in name for word in unused)
    }
    faults = [
        f"{name!r} is missing" for name in needed if name not in saved
    ] + [
        f"{name!r} is unknown ({nearest(name, needed)})" for name in saved if name not in needed
    ] + [
        f"{name!r} has shape {tuple(saved[name].shape)}, not {tuple(tensor.shape)}"
        for name, tensor in needed.items()
        if name in saved and saved[name].shape != tensor.shape
    ]  # fmt: skip
    if faults:
        shown = "; ".join(faults[:4]) + (f"; and {len(faults) - 4} more" * (len(faults) > 4))
        raise PolicyError(
            f"{where}: the weights are not those of {network.__class__.__name__}: {shown}",
            fix="check `adapter` on the card, and which network the file was saved from",
        )
    cast = {name: _as(saved[name], like) for name, like in needed.items()}
    network.load_state_dict(cast, assign=True, strict=False)
    return network.eval().requires_grad_(requires_grad=False)


def _as(tensor: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    return tensor.to(torch.float32) if like.is_floating_point() else tensor


def mlp(sizes: Sequence[int], *, last: nn.Module | None = None) -> nn.Sequential:
    """Return linear layers with ELU between them, and `last` after them."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ELU()]
    layers[-1:] = [last] if last is not None else []
    return nn.Sequential(*layers)
