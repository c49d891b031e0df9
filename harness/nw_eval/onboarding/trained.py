"""What a training's own checkpoint holds: which trainer wrote it, and the options that run it.

rsl_rl, skrl, rl_games, CleanRL, Stable-Baselines3, brax and flax are told apart by the names of the
tensors. The activation is in none of these files but those of Stable-Baselines3.

Beside a model of Stable-Baselines3, `env.save("vecnormalize.pkl")` pickles the wrapper
`VecNormalize` itself, which says how observations are normalised. It is read for its arrays alone,
as all pickles are: no class of it is imported. Its inference is
`clip((obs - mean) / sqrt(var + epsilon), -clip_obs, clip_obs)`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from nw_eval.errors import PolicyError
from nw_eval.files.inside import bounded_bytes, what_is
from nw_eval.onboarding.checkpoint import CheckpointFacts
from nw_eval.onboarding.notation import CHECK, number, plain, quoted
from nw_eval.policies.networks.layers import Layer, Shape, chain
from nw_eval.policies.safety.objects import Record, TensorRef, read_index

KNOWN_ACTIVATIONS = frozenset(
    {"elu", "relu", "tanh", "silu", "selu", "gelu", "leaky_relu", "sigmoid", "softplus", "mish"}
)
"""Activations that `adapter: mlp` runs and trainers name."""
_OTHERS = re.compile(
    r"critic|value|teacher|optim|std|target|qf\d|memory_c|sigma|count|rnd|normaliz|preprocessor|"
    r"running_|norm_state|disc|distribution|action_(scale|bias)",
    re.IGNORECASE,
)
"""Tensors that a policy in use does not need."""


@dataclass(frozen=True, kw_only=True)
class TrainedNetwork:
    """The actor in a training's checkpoint."""

    trainer: str
    weights: tuple[str, ...]
    """Parts of the chain, in the order in which they run."""
    layers: tuple[Layer, ...]
    activation: str
    """The trainer's default, where it is unknown another."""
    last: str = ""
    """Activation behind the last layer; none if empty."""
    outputs: int | None = None
    """Numbers of the last layer that are the action; None = all."""
    normaliser: str = ""
    """As the card writes it; empty where the file has none."""
    normaliser_of: str = ""
    """The file beside it that has the normaliser; empty where the checkpoint has it."""
    notes: tuple[str, ...] = ()
    """Sentences that the author of the card must read."""
    clip: float | None = None
    """Limit of actions in the trainer's own inference."""


@dataclass(frozen=True, kw_only=True)
class _Pattern:
    """Names that one trainer gives."""

    trainer: str
    chains: tuple[tuple[str, ...], ...]
    """Parts, of which those that begin with `?` may be missing; the first chain that is there is
    taken."""
    activation: str
    last: str = ""
    normaliser: tuple[tuple[str, str], ...] = ()
    """What the names of the tensors begin with, and the card's words behind them."""
    clip: float | None = None


_EMPIRICAL = "{{mean: {0}._mean, std: {0}._std, eps: 0.01}}"
_SKRL = "{{mean: {0}.running_mean, variance: {0}.running_variance, eps: 0.00000001, clip: 5}}"
_RL_GAMES = (
    "{{mean: {0}.running_mean, variance: {0}.running_var, eps: 0.00001, eps_in: variance, clip: 5}}"
)
_PATTERNS = (
    _Pattern(
        trainer="rsl_rl",
        chains=(
            ("?actor_state_dict.rnn.rnn", "actor_state_dict.mlp"),
            ("?student_state_dict.rnn.rnn", "student_state_dict.mlp"),
        ),
        activation="elu",
        normaliser=(
            ("actor_state_dict.obs_normalizer", _EMPIRICAL),
            ("student_state_dict.obs_normalizer", _EMPIRICAL),
        ),
    ),
    *(
        _Pattern(
            trainer="rsl_rl",
            chains=(
                (f"?{root}memory_a.rnn", f"{root}actor"),
                (f"?{root}memory_s.rnn", f"{root}student"),
            ),
            activation="elu",
            normaliser=(
                (f"{root}actor_obs_normalizer", _EMPIRICAL),
                (f"{root}student_obs_normalizer", _EMPIRICAL),
                ("obs_norm_state_dict", _EMPIRICAL),
            ),
        )
        for root in ("model_state_dict.", "")
    ),
    *(
        _Pattern(
            trainer="skrl",
            chains=((f"{root}net_container", f"?{root}policy_layer"),),
            activation="elu",
            normaliser=(("observation_preprocessor", _SKRL), ("state_preprocessor", _SKRL)),
        )
        for root in ("policy.", "")
    ),
    _Pattern(
        trainer="rl_games",
        chains=(
            (
                "model.a2c_network.actor_mlp",
                "?model.a2c_network.rnn.rnn",
                "?model.a2c_network.layer_norm",
                "model.a2c_network.mu",
            ),
            (
                "?model.a2c_network.rnn.rnn",
                "?model.a2c_network.layer_norm",
                "model.a2c_network.actor_mlp",
                "model.a2c_network.mu",
            ),
        ),
        activation="elu",
        normaliser=(("model.running_mean_std", _RL_GAMES),),
        clip=1,
    ),
    _Pattern(
        trainer="Stable-Baselines3",
        chains=(
            (
                "?lstm_actor",
                "?mlp_extractor.shared_net",
                "mlp_extractor.policy_net",
                "action_net",
            ),
        ),
        activation="tanh",
    ),
    _Pattern(
        trainer="Stable-Baselines3 (SAC)",
        chains=(("actor.latent_pi", "actor.mu"),),
        activation="relu",
        last="tanh",
    ),
    *(
        _Pattern(
            trainer="CleanRL",
            chains=((f"{root}fc1", f"{root}fc2", f"?{root}fc3", f"{root}{mean}"),),
            activation="relu",
            last="tanh",
        )
        for root in ("actor.", "")
        for mean in ("fc_mean", "fc_mu")
    ),
    _Pattern(trainer="CleanRL", chains=(("actor_mean",), ("agent.actor_mean",)), activation="tanh"),
    _Pattern(
        trainer="brax",
        chains=(("1.params",),),
        activation="silu",
        last="tanh",
        normaliser=(
            ("0.mean.state", "{{mean: 0.mean.state, std: 0.std.state}}"),
            ("0.mean", "{{mean: 0.mean, std: 0.std}}"),
        ),
    ),
)


def trained_network(facts: CheckpointFacts, joints: int) -> TrainedNetwork | None:
    """Return the actor of a checkpoint; None where no chain of layers gives an action.

    Args:
        facts: what the file says.
        joints: how many numbers an action has.
    """
    shapes = {tensor.name: tensor.shape for tensor in facts.tensors}
    for pattern in _PATTERNS:
        for parts in pattern.chains:
            weights = [part.removeprefix("?") for part in parts if _there(part, shapes)]
            if not all(part.startswith("?") or _there(part, shapes) for part in parts):
                continue
            found = _network(pattern, weights, shapes, joints)
            if found is not None:
                return _noted(found, shapes)
    chains = [
        (prefix, layers)
        for prefix in _prefixes(shapes)
        if (layers := _layers([prefix], shapes)) and layers[-1].outputs in {joints, 2 * joints}
    ]
    wanted = [pair for pair in chains if not _OTHERS.search(pair[0])] or chains
    if not wanted:
        return None
    prefix, layers = wanted[0]
    flax = layers[0].transposed
    network = TrainedNetwork(
        trainer="flax" if flax else "an unknown trainer",
        weights=(prefix,),
        layers=layers,
        activation="tanh" if flax else "elu",
        outputs=joints if layers[-1].outputs == 2 * joints else None,
        notes=tuple(
            f"the layers below {quoted(other)} give an action too" for other, _ in wanted[1:]
        ),
    )
    return _noted(network, shapes)


def _network(
    pattern: _Pattern, weights: Sequence[str], shapes: Mapping[str, Shape], joints: int
) -> TrainedNetwork | None:
    layers = _layers(weights, shapes)
    if not layers or layers[-1].outputs not in {joints, 2 * joints}:
        return None
    normalised = next(
        (words.format(name) for name, words in pattern.normaliser if _there(name, shapes)), ""
    )
    return TrainedNetwork(
        trainer=pattern.trainer,
        weights=tuple(weights),
        layers=layers,
        activation=pattern.activation,
        last=pattern.last,
        outputs=joints if layers[-1].outputs == 2 * joints else None,
        normaliser=normalised,
        clip=pattern.clip,
    )


def _layers(weights: Sequence[str], shapes: Mapping[str, Shape]) -> tuple[Layer, ...]:
    try:
        return chain(shapes, weights, "")
    except PolicyError:
        return ()


def _there(part: str, shapes: Mapping[str, Shape]) -> bool:
    part = part.removeprefix("?")
    return any(name == part or name.startswith(f"{part}.") for name in shapes)


def _prefixes(shapes: Mapping[str, Shape]) -> Iterable[str]:
    """Return what the names of layers may begin with: the actor's before others."""
    names = dict.fromkeys(
        name.rpartition(".")[0].rpartition(".")[0]
        for name, shape in shapes.items()
        if len(shape) == 2
    )
    return sorted(names, key=lambda name: not re.search("actor|policy|pi", name))


def _noted(network: TrainedNetwork, shapes: Mapping[str, Shape]) -> TrainedNetwork:
    """Return a network with a note of others in the file, which may feed it."""
    own = tuple(f"{part}." for part in network.weights)
    others = dict.fromkeys(
        name.rpartition(".")[0].rstrip(".0123456789")
        for name, shape in shapes.items()
        if len(shape) >= 2 and not name.startswith(own) and not _OTHERS.search(name)
    )
    if network.trainer == "brax":
        others = {name: None for name in others if not name.startswith("2.")}
    if not others:
        return network
    note = (
        f"the file has other networks: {plain(', '.join(others))}. If they feed the actor, export "
        "the policy as ONNX: this card does not run them"
    )
    return replace(network, notes=(*network.notes, note))


def network_lines(network: TrainedNetwork, activation: str = "", source: str = "") -> list[str]:
    """Return the lines `options` of a card.

    Args:
        network: from `trained_network`.
        activation: between two layers, where a file says it.
        source: which file does.
    """
    weights = [quoted(part) if part else '""' for part in network.weights]
    lines = [
        "options:",
        "  weights: " + (weights[0] if len(weights) == 1 else f"[{', '.join(weights)}]"),
        *(f"  {CHECK} {note}" for note in network.notes),
    ]
    if activation:
        lines.append(f"  activation: {activation}  # {source}")
    else:
        common = f"{CHECK} it is not in the file; {network.activation} is {network.trainer}'s habit"
        lines.append(f"  activation: {network.activation}  {common}")
    if network.last:
        lines.append(f"  last: {network.last}  # behind the last layer, as {network.trainer}")
    if network.outputs is not None:
        given = network.layers[-1].outputs
        lines.append(f"  outputs: {network.outputs}  # of {given}: the others are deviations")
    said = network.normaliser_of or f"as {network.trainer}"
    if network.normaliser:
        lines.append(f"  normaliser: {network.normaliser}  # {said}")
    else:
        lines.append(f"  # normaliser: none  {CHECK} the file has none")
    kinds = {"linear": "", "norm": " (normalised)"}
    steps = [
        f"{layer.outputs}{kinds.get(layer.kind, f' ({layer.kind})')}" for layer in network.layers
    ]
    sizes = " -> ".join([str(network.layers[0].inputs), *steps])
    return [*lines, f"  # {network.trainer}: {sizes}"]


_LARGEST = 2**22
"""Bytes: it has a few numbers for each of the observation's, and the last observation."""
_CALLED = re.compile(r"_?vec_?normali[sz]e", re.IGNORECASE)
_CLASS = "stable_baselines3.common.vec_env.vec_normalize.VecNormalize"


@dataclass(frozen=True, kw_only=True)
class Statistics:
    """How a model's observations are normalised."""

    file: str
    mean: tuple[float, ...]
    variance: tuple[float, ...]
    eps: float
    clip: float

    def line(self) -> str:
        """Return the normaliser as a card writes it."""
        mean, variance = (", ".join(map(_nine_digits, v)) for v in (self.mean, self.variance))
        rest = f"eps: {number(self.eps)}, eps_in: variance, clip: {number(self.clip)}"
        return f"{{mean: [{mean}], variance: [{variance}], {rest}}}"


def statistics_beside(checkpoint: Path) -> Path | None:
    """Return the file of statistics of a model, which is saved beside it; None where none is.

    `model_1000_steps.zip` has `model_vecnormalize_1000_steps.pkl`, `best_model.zip` a
    `vecnormalize.pkl` beside it, in a folder there (rl_zoo3) or in the folder above.
    """
    if checkpoint.suffix != ".zip":
        return None
    own = checkpoint.parent
    for folder in (own, *sorted(p for p in own.glob("*") if what_is(p) == "folder"), own.parent):
        found = [p for p in sorted(folder.glob("*.pkl")) if _CALLED.search(p.stem)]
        found = [p for p in found if what_is(p) == "file"]
        for path in found:
            if _CALLED.sub("", path.stem) in {checkpoint.stem, f"{checkpoint.stem}_"}:
                return path
        for path in found:
            if _CALLED.fullmatch(path.stem):
                return path
        if len(found) == 1 and folder == own and not re.search(r"\d", found[0].stem):
            return found[0]
    return None


def normalised(network: TrainedNetwork, statistics: Path | None) -> TrainedNetwork:
    """Return a network with the normaliser of a file of its own, where it has one.

    Raises:
        PolicyError: as `read_statistics`.
    """
    if statistics is None or not network.trainer.startswith("Stable-Baselines3"):
        return network
    found = read_statistics(statistics, network.layers[0].inputs)
    if found is None:
        return network
    return replace(network, normaliser=found.line(), normaliser_of=found.file)


def read_statistics(path: Path, size: int) -> Statistics | None:
    """Read the statistics of observations; None where the training normalised none.

    Args:
        path: of the pickle.
        size: numbers that the model takes.

    Raises:
        PolicyError: it asks for a call that no such file has, is no `VecNormalize`, or of
            observations of another size.
    """
    where = str(path)
    try:
        data = bounded_bytes(path, _LARGEST)
    except (OSError, ValueError) as error:
        raise PolicyError(
            f"{where}: the statistics cannot be read: {error}", fix="check the file"
        ) from None
    saved = read_index(data, where, pickled=True).tree
    state = _state(saved, _CLASS)
    if state.get("norm_obs") is False:
        return None
    rms = state.get("obs_rms")
    found = _state(rms, "stable_baselines3.common.running_mean_std.RunningMeanStd")
    mean, variance = _numbers(found.get("mean")), _numbers(found.get("var"))
    eps, clip = state.get("epsilon"), state.get("clip_obs")
    if not (mean and variance and isinstance(eps, float) and isinstance(clip, int | float)):
        what = "statistics by the keys of a dict" if isinstance(rms, dict) else "no statistics"
        raise PolicyError(
            f"{where}: the file has {what} of observations, no `VecNormalize` of a row of numbers",
            fix="normalise in the policy itself, and export it as ONNX",
        )
    if not len(mean) == len(variance) == size:
        raise PolicyError(
            f"{where}: it is about {len(mean)} numbers, the model takes {size}",
            fix="move it away if it is another model's",
        )
    return Statistics(
        file=plain(path.name), mean=mean, variance=variance, eps=eps, clip=float(clip)
    )


def _state(value: Any, name: str) -> Mapping[str, Any]:
    """Return the attributes of an object of a class; none of another."""
    state = value.state if isinstance(value, Record) and value.name == name else None
    return cast("Mapping[str, Any]", state) if isinstance(state, dict) else {}


def _numbers(value: Any) -> tuple[float, ...]:
    """Return a row of numbers; empty where it is none."""
    import numpy as np

    ref = value.state if isinstance(value, Record) else value
    if not isinstance(ref, TensorRef) or ref.storage.raw is None or len(ref.shape) != 1:
        return ()
    if ref.storage.dtype not in {"float64", "float32"}:
        return ()
    numbers = np.frombuffer(ref.storage.raw, ref.storage.dtype)
    return tuple(numbers.tolist()) if np.isfinite(numbers).all() else ()


def _nine_digits(value: float) -> str:
    """Return a number as YAML reads it, with all the digits that float32 has."""
    short = f"{value:.9g}"
    if "e" not in short:
        return short
    return f"{value:.30f}".rstrip("0") if abs(value) < 1 else f"{value:.1f}"
