"""Policies from a training's saved weights: a chain of linear and recurrent layers.

The names of the tensors say which layers there are (`networks.layers`); the card says what is not
in the file: the activation, and how observations are normalised. Checkpoints of rsl_rl, skrl,
rl_games, CleanRL, Stable-Baselines3, brax and flax have such networks.

Normalisation is (x - mean) / (std + eps) as in rsl_rl and brax, with std = sqrt(variance) as in
skrl, or (x - mean) / sqrt(variance + eps) as in rl_games; then a clip.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.nn import functional

from nw_base.errors import PolicyError, nearest
from nw_policies.bundle import Bundle, read_options
from nw_policies.cards.model import CardModel, Limits
from nw_policies.networks.layers import Layer, chain, unwrapped
from nw_policies.torch_network import NetworkPolicy, checkpoint_tensors, input_spec

ActivationName = Literal[
    "elu", "relu", "tanh", "silu", "swish", "selu", "gelu", "leaky_relu", "sigmoid", "softplus",
    "softsign", "mish", "identity",
]  # fmt: skip
_ACTIVATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "elu": functional.elu,
    "relu": functional.relu,
    "tanh": torch.tanh,
    "silu": functional.silu,
    "swish": functional.silu,
    "selu": functional.selu,
    "gelu": functional.gelu,
    "leaky_relu": functional.leaky_relu,
    "sigmoid": torch.sigmoid,
    "softplus": functional.softplus,
    "softsign": functional.softsign,
    "mish": functional.mish,
    "identity": lambda x: x,
}


Row = str | Annotated[list[float], Field(min_length=1, max_length=100_000)]
"""Numbers, one for each that the policy sees: the name of a tensor, or the numbers themselves."""


class Normaliser(CardModel):
    """How observations are normalised before the first layer."""

    mean: Row
    std: Row | None = None
    """Standard deviations; `variance` in their place where the file has those."""
    variance: Row | None = None
    eps: float = Field(default=0.0, ge=0.0)
    """Added to the divisor."""
    eps_in: Literal["std", "variance"] = "std"
    """Whether `eps` is added to the standard deviation, or to the variance below the root."""
    clip: Limits | None = None
    """Limits of what is normalised."""

    @model_validator(mode="after")
    def _one_spread(self) -> Normaliser:
        if (self.std is None) == (self.variance is None):
            raise ValueError("name one of `std` and `variance`")
        if self.eps_in == "variance" and self.variance is None:
            raise ValueError("`eps_in: variance` needs `variance`")
        return self


class MlpOptions(CardModel):
    """What the file of weights does not say."""

    weights: str | list[str]
    """What the names of the tensors begin with: of the whole network, or of each of its parts in
    the order in which they run."""
    activation: ActivationName
    """Between two linear layers."""
    last: ActivationName = "identity"
    """After the last layer."""
    outputs: int | None = Field(default=None, ge=1)
    """How many numbers of the last layer are the action, from the first; None = all."""
    output_scale: Row | None = None
    """What the numbers behind `last` are multiplied with; None = 1."""
    output_bias: Row | None = None
    """What is then added; None = 0."""
    normaliser: Normaliser | None = None


class MlpPolicy(NetworkPolicy):
    """A chain of layers; the hidden state of those that have one is its memory."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        """Open the file of a card.

        Raises:
            PolicyError: it cannot be read, or has not the layers that the card names.
        """
        options = read_options(bundle, MlpOptions)
        where = str(bundle.checkpoint)
        weights = [options.weights] if isinstance(options.weights, str) else options.weights
        tensors = checkpoint_tensors(bundle)
        if unwrapped(dict.fromkeys((f"{name}." for name in weights), 0)).keys() == {
            f"{name}." for name in weights
        }:
            tensors = unwrapped(tensors)
        shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
        layers = chain(shapes, weights, where)
        given = layers[-1].outputs
        if (options.outputs or given) != joints or given < joints:
            raise PolicyError(
                f"{bundle.where}: the last layer, {layers[-1].name!r}, gives {given} numbers, the "
                f"robot {bundle.card.robot!r} has {joints} joints",
                fix=f"write `outputs: {joints}` in `options` if the first ones are the action"
                if given > joints
                else "name the right robot with `robot`, or the actor's layers with `weights`",
            )
        self._joints_of_last = joints
        self._activation = _ACTIVATIONS[options.activation]
        self._last = _ACTIVATIONS[options.last]
        self._layers = [(layer, _module(layer, tensors)) for layer in layers]
        self._normalise = _normalise(options.normaliser, tensors, layers[0].inputs, where)
        rows = (("output_scale", options.output_scale), ("output_bias", options.output_bias))
        self._scale, self._bias = (
            None if row is None else _row(row, tensors, joints, where, key) for key, row in rows
        )
        super().__init__(bundle, (input_spec("obs", layers[0].inputs),), joints=joints)

    def forget(self) -> None:
        """Begin with hidden states of zeros."""
        self._hidden: dict[str, tuple[Tensor, ...]] = {
            layer.name: tuple(
                torch.zeros(layer.depth, 1, layer.outputs)
                for _ in range(1 + (layer.kind == "lstm"))
            )
            for layer, _ in self._layers
            if layer.kind in {"lstm", "gru", "rnn"}
        }

    def infer(self, inputs: dict[str, Tensor]) -> Tensor:
        """Return the mean of the action's distribution."""
        x = self._normalise(inputs["obs"])
        for layer, module in self._layers:
            if layer.name in self._hidden:
                hidden = self._hidden[layer.name]
                x, after = module(x[None], hidden if layer.kind == "lstm" else hidden[0])
                x = x[0]
                self._hidden[layer.name] = after if layer.kind == "lstm" else (after,)
            else:
                x = module(x)
            if layer.activated:
                x = self._activation(x)
        action = self._last(x[..., : self._joints_of_last])
        action = action if self._scale is None else action * self._scale
        return action if self._bias is None else action + self._bias

    def memory(self) -> dict[str, Tensor]:
        """Return the hidden states."""
        return {
            f"{index} {number}": tensor
            for index, hidden in enumerate(self._hidden.values())
            for number, tensor in enumerate(hidden)
        }

    def remember(self, memory: Mapping[str, Tensor]) -> None:
        """Take hidden states."""
        self._hidden = {
            name: tuple(
                memory[f"{index} {number}"].view(tensor.shape)
                for number, tensor in enumerate(hidden)
            )
            for index, (name, hidden) in enumerate(self._hidden.items())
        }


def _module(layer: Layer, tensors: Mapping[str, Tensor]) -> nn.Module:
    """Return a layer with its weights, float32."""
    prefix = f"{layer.name}." if layer.name else ""
    own = {
        name.removeprefix(prefix): tensor.to(torch.float32)
        for name, tensor in tensors.items()
        if name.startswith(prefix)
    }
    if "kernel" in own:
        own["weight"] = own.pop("kernel").T.contiguous()
    biased = any(name.startswith("bias") for name in own)
    with torch.device("meta"):
        if layer.kind == "linear":
            module: nn.Module = nn.Linear(layer.inputs, layer.outputs, bias=biased)
        elif layer.kind == "norm":
            module = nn.LayerNorm(layer.inputs, bias=biased)
        else:
            make = {"lstm": nn.LSTM, "gru": nn.GRU, "rnn": nn.RNN}[layer.kind]
            module = make(layer.inputs, layer.outputs, num_layers=layer.depth, bias=biased)
    for name, tensor in own.items():
        if not bool(torch.isfinite(tensor).all()):
            raise PolicyError(
                f"the tensor '{prefix}{name}' has NaN or infinite numbers",
                fix="take an earlier checkpoint of the training",
            )
    module.load_state_dict(own, assign=True)
    return module.eval().requires_grad_(requires_grad=False)


def _normalise(
    options: Normaliser | None, tensors: Mapping[str, Tensor], size: int, where: str
) -> Callable[[Tensor], Tensor]:
    """Return what is done to observations before the first layer.

    Raises:
        PolicyError: the file has no such tensors, or they are of another size.
    """
    if options is None:
        return lambda x: x

    def numbers(row: Row) -> Tensor:
        return _row(row, tensors, size, where, "normaliser")

    mean, eps = numbers(options.mean), options.eps
    if options.eps_in == "variance":
        divisor = torch.sqrt(numbers(options.variance or "") + eps)
    elif options.variance is not None:
        divisor = torch.sqrt(numbers(options.variance)) + eps
    else:
        divisor = numbers(options.std or "") + eps
    if not bool((torch.isfinite(divisor) & (divisor > 0)).all()):
        raise PolicyError(
            f"{where}: `normaliser` divides by numbers that are not above 0",
            fix="correct `std`, `variance` or `eps` in `normaliser`",
        )
    limits = options.clip
    if limits is None:
        return lambda x: (x - mean) / divisor
    return lambda x: torch.clamp((x - mean) / divisor, *limits)


def _row(row: Row, tensors: Mapping[str, Tensor], size: int, where: str, key: str) -> Tensor:
    """Return the numbers of an option, (1, `size`) float32.

    Raises:
        PolicyError: no tensor has that name, or there are more or fewer, or one is not finite.
    """
    if isinstance(row, str) and row not in tensors:
        raise PolicyError(
            f"{where}: no tensor is called {row!r}",
            fix=f"correct `{key}`; {nearest(row, list(tensors))}",
        )
    values = tensors[row] if isinstance(row, str) else torch.tensor(row)
    values = values.expand(size) if values.numel() == 1 and key != "normaliser" else values
    said = repr(row) if isinstance(row, str) else f"`{key}`"
    if values.numel() != size:
        layer = "the first layer takes" if key == "normaliser" else "the action has"
        raise PolicyError(
            f"{where}: {said} has {values.numel()} numbers, {layer} {size}",
            fix=f"correct `{key}`: it is another network's",
        )
    values = values.to(torch.float32).reshape(1, size)
    if not bool(torch.isfinite(values).all()):
        raise PolicyError(f"{where}: {said} has NaN or infinite numbers", fix=f"correct `{key}`")
    return values
