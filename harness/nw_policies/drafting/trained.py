"""Contents of a training's own checkpoint: its trainer, and the options that run it.

rsl_rl, skrl, rl_games, CleanRL, Stable-Baselines3, brax and flax are told apart by the names of the
tensors. The activation is in none of these files but those of Stable-Baselines3.

Beside a model of Stable-Baselines3, `env.save("vecnormalize.pkl")` pickles the wrapper
`VecNormalize` itself, which says how observations are normalised. It is read for its arrays alone,
as all pickles are: no class of it is imported. Its inference is
`clip((obs - mean) / sqrt(var + epsilon), -clip_obs, clip_obs)`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from nw_base.errors import PolicyError
from nw_base.files.inside import bounded_bytes, what_is
from nw_policies.drafting.checkpoint import CheckpointFacts
from nw_policies.drafting.notation import CHECK, in_brackets, number, plain, quoted
from nw_policies.networks.layers import Layer, Shape, chain, unwrapped
from nw_policies.safety.objects import Record, TensorRef, read_index

KNOWN_ACTIVATIONS = frozenset(
    {"elu", "relu", "tanh", "silu", "selu", "gelu", "leaky_relu", "sigmoid", "softplus", "mish"}
)
"""Activations that `adapter: mlp` runs and trainers name."""
_PASSED_OVER = {
    "it judges the policy or teaches it, and does not act": (
        r"critic|value|teacher|target|privileged|memory_c|_old\.|(^|\.)(vf|qf?|q_net)\d*\."
    ),
    "it is the state of a training": (
        r"optim|scheduler|(^|\.)(scaler|grad_scaler|rnd\w*|amp_\w+|disc\w*|rew\w*|infos?|iter\w*|"
        r"epoch\w*|frames?|\w*steps?|env_state|last_mean_rewards|optimizer\w*|seed|cfg)(\.|$)"
    ),
    "it says how widely a training draws actions": (
        r"(^|[._])(log_?)?std(_param(eter)?)?(\.|$)|logstd|sigma|distribution|entropy|log_alpha"
    ),
    "it counts what was seen": r"(^|[._])(count|num_batches_tracked|version)$",
}
"""What of a training's file has no effect on a policy in use: the reason, and names of entries."""
_OTHERS = re.compile("|".join(_PASSED_OVER.values()), re.IGNORECASE)
_UNKNOWN = "an unknown trainer"
_STATISTICS = re.compile(r"normali[sz]|preproc|running_|rms|(^|[._])(mean|var|variance)(\.|$)")
"""Names of what observations may be normalised by; its `std` is no deviation of actions."""


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
    clip: tuple[float, float] | None = None
    """Limits of actions in the trainer's own inference."""
    output_scale: str = ""
    """What is multiplied with the last activation, as the card writes it; 1 if empty."""
    output_bias: str = ""
    """What is added to that; 0 if empty."""

    @property
    def is_known(self) -> bool:
        """Whether the names of its tensors are those of a trainer, and not only its sizes fit."""
        return self.trainer not in {"flax", _UNKNOWN}


@dataclass(frozen=True, kw_only=True)
class _Pattern:
    """Names that one trainer gives, behind whatever a file begins them with."""

    trainer: str
    chains: tuple[tuple[str, ...], ...]
    """Parts, of which those that begin with `?` may be missing; the first chain that is there is
    taken."""
    activation: str
    last: str = ""
    normaliser: tuple[tuple[str, str], ...] = ()
    """What the names of the tensors begin with, and the card's words behind them."""
    clip: tuple[float, float] | None = None
    bounded: bool = False
    """Whether tensors `action_scale` and `action_bias` lead from the network to actions."""
    note: str = ""


_UNBOUNDED = (
    "the limits of its actions are not in the file: -1 and 1 are assumed; write `output_scale` and "
    "`output_bias` for others"
)
_EMPIRICAL = "{{mean: {0}._mean, std: {0}._std, eps: 0.01}}"
_SKRL = "{{mean: {0}.running_mean, variance: {0}.running_variance, eps: 0.00000001, clip: 5}}"
_RL_GAMES = (
    "{{mean: {0}.running_mean, variance: {0}.running_var, eps: 0.00001, eps_in: variance, clip: 5}}"
)
_PATTERNS = (
    _Pattern(
        trainer="rsl_rl",
        chains=(("?rnn.rnn", "mlp"),),
        activation="elu",
        normaliser=(("obs_normalizer", _EMPIRICAL),),
    ),
    _Pattern(
        trainer="rsl_rl",
        chains=(("?memory_a.rnn", "actor"), ("?memory_s.rnn", "student")),
        activation="elu",
        normaliser=(
            ("actor_obs_normalizer", _EMPIRICAL),
            ("student_obs_normalizer", _EMPIRICAL),
            ("obs_norm_state_dict", _EMPIRICAL),
        ),
    ),
    _Pattern(
        trainer="skrl",
        chains=(("net_container", "?policy_layer"),),
        activation="elu",
        normaliser=(("observation_preprocessor", _SKRL), ("state_preprocessor", _SKRL)),
    ),
    _Pattern(
        trainer="rl_games",
        chains=(
            ("a2c_network.actor_mlp", "?a2c_network.rnn.rnn", "?a2c_network.layer_norm",
             "a2c_network.mu"),
            ("?a2c_network.rnn.rnn", "?a2c_network.layer_norm", "a2c_network.actor_mlp",
             "a2c_network.mu"),
        ),
        activation="elu",
        normaliser=(("running_mean_std", _RL_GAMES),),
        clip=(-1, 1),
    ),
    _Pattern(
        trainer="Stable-Baselines3",
        chains=(
            ("?lstm_actor", "?mlp_extractor.shared_net", "mlp_extractor.policy_net", "action_net"),
        ),
        activation="tanh",
    ),
    _Pattern(
        trainer="Stable-Baselines3 (SAC)",
        chains=(("actor.latent_pi", "actor.mu"),),
        activation="relu",
        last="tanh",
    ),
    _Pattern(
        trainer="Stable-Baselines3 (TD3)",
        chains=(("actor.mu",),),
        activation="relu",
        last="tanh",
    ),
    _Pattern(
        trainer="CleanRL",
        chains=(("fc1", "fc2", "?fc3", "fc_mean"), ("fc1", "fc2", "?fc3", "fc_mu")),
        activation="relu",
        last="tanh",
        bounded=True,
    ),
    _Pattern(trainer="CleanRL", chains=(("actor_mean",),), activation="tanh"),
    _Pattern(
        trainer="TorchRL",
        chains=(("module.0.module.0",), ("module.0.module",)),
        activation="tanh",
        last="tanh",
        note=f"tanh ends it where the training drew from TanhNormal; {_UNBOUNDED}",
    ),
    _Pattern(
        trainer="tianshou",
        chains=(
            ("preprocess.model.model", "mu.model"), ("preprocess.model.model", "last.model"),
        ),
        activation="relu",
        last="tanh",
        note="tanh ends it unless it is `unbounded` and no SAC, which is not in the file; "
        + _UNBOUNDED,
    ),
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
)  # fmt: skip


def trained_network(facts: CheckpointFacts, joints: int) -> TrainedNetwork | None:
    """Return the actor of a checkpoint; None where no chain of layers gives an action.

    Args:
        facts: what the file says.
        joints: how many numbers an action has.
    """
    shapes = unwrapped({tensor.name: tensor.shape for tensor in facts.tensors})
    entries = tuple(facts.entries)
    for pattern in _PATTERNS:
        for parts in pattern.chains:
            for root in _roots(parts, shapes):
                wanted = [f"{root}{part.removeprefix('?')}" for part in parts]
                weights = [part for part in wanted if _there(part, shapes)]
                actor = _network(pattern, root, weights, shapes, joints)
                if actor is not None and not _is_fed(actor, shapes):
                    actor = _within_bounds(actor, facts.metadata, joints)
                    return _accounted(actor, shapes, entries)
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
        trainer="flax" if flax else _UNKNOWN,
        weights=(prefix,),
        layers=layers,
        activation="tanh" if flax else "elu",
        outputs=joints if layers[-1].outputs == 2 * joints else None,
        notes=(
            f"layers below {quoted(prefix)} taken for their sizes; many end in `last: tanh`",
            *(f"the layers below {quoted(other)} give an action too" for other, _ in wanted[1:]),
        ),
    )
    return None if _is_fed(network, shapes) else _accounted(network, shapes, entries)


def _network(
    pattern: _Pattern, root: str, weights: Sequence[str], shapes: Mapping[str, Shape], joints: int
) -> TrainedNetwork | None:
    layers = _layers(weights, shapes)
    if not layers or layers[-1].outputs not in {joints, 2 * joints}:
        return None
    normalised = next(
        (
            words.format(place)
            for name, words in pattern.normaliser
            for place in (f"{root}{name}", name)
            if _there(place, shapes)
        ),
        "",
    )
    scale, bias = (f"{root}action_{what}" for what in ("scale", "bias"))
    known = pattern.bounded and {scale, bias} <= set(shapes)
    note = _UNBOUNDED if pattern.bounded and not known else pattern.note
    return TrainedNetwork(
        trainer=pattern.trainer,
        weights=tuple(weights),
        layers=layers,
        activation=pattern.activation,
        last=pattern.last,
        outputs=joints if layers[-1].outputs == 2 * joints else None,
        normaliser=normalised,
        clip=pattern.clip,
        output_scale=quoted(scale) if known else "",
        output_bias=quoted(bias) if known else "",
        notes=(note,) if note else (),
    )


def _within_bounds(
    network: TrainedNetwork, settings: Mapping[str, str], joints: int
) -> TrainedNetwork:
    """Return a network of Stable-Baselines3 with the limits of its action space.

    Where tanh ends it, -1 and 1 are those limits; else actions are clipped at them.
    """
    if not network.trainer.startswith("Stable-Baselines3"):
        return network
    notes = [*network.notes]
    if settings.get("squash_output") == "True":
        network = replace(network, last="tanh")
    if settings.get("use_sde") == "True" and "SAC" in network.trainer:
        notes.append(
            "gSDE: its actor limits means to `clip_mean`, 2, before tanh; the card does not"
        )
    if unread := settings.get("unread"):
        notes.append(f"the zip has settings that the card does not: {unread}")
    low, high = (_listed(settings.get(f"action_{side}", "")) for side in ("low", "high"))
    fits = len(low) == len(high) == joints and all(a < b for a, b in zip(low, high, strict=True))
    finite = fits and not any(map(math.isinf, (*low, *high)))
    if not fits or (network.last and not finite):
        what = f"{low} to {high}" if low or high else "absent"
        clips = "the trainer clips actions at its limits: write `clip` in `control`"
        rule = _UNBOUNDED if network.last else clips
        notes.append(f"`action_space` of the zip is {what}: {rule}")
    elif network.last and set(low) | set(high) != {-1.0, 1.0}:
        half = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
        middle = [(b + a) / 2 for a, b in zip(low, high, strict=True)]
        scale, bias = (f"[{', '.join(map(_nine_digits, row))}]" for row in (half, middle))
        network = replace(network, output_scale=scale, output_bias=bias)
    elif not network.last and finite:
        if len(set(low)) == len(set(high)) == 1:
            network = replace(network, clip=(low[0], high[0]))
        else:
            notes.append(
                f"the trainer clips actions, each joint's by itself, to {in_brackets(low)} and "
                f"{in_brackets(high)}; a card has one `clip` for all"
            )
    return replace(network, notes=tuple(notes))


def _listed(text: str) -> tuple[float, ...]:
    """Return the numbers of an array as NumPy prints it; empty where it is none."""
    try:
        numbers = tuple(float(word) for word in text.strip("[] \n").split())
    except ValueError:
        return ()
    return () if any(map(math.isnan, numbers)) else numbers


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


def _roots(parts: Sequence[str], shapes: Mapping[str, Shape]) -> list[str]:
    """Return what all parts of a chain that must be there begin with, the shortest first."""
    needed = [re.escape(part) for part in parts if not part.startswith("?")]
    prefixes = [
        {match[1] for name in shapes if (match := re.match(rf"((?:.*?\.)??){part}\.", name))}
        for part in needed
    ]
    return sorted(
        (root for root in set.intersection(*prefixes) if not _OTHERS.search(root)),
        key=lambda root: (root.count("."), root.startswith("ema"), root),
    )


def _left(network: TrainedNetwork, shapes: Mapping[str, Shape]) -> dict[str, Shape]:
    """Return the tensors that a network does not use and that have not been passed over."""
    words = re.findall(r"[\w.]+", network.normaliser)
    words += [name.rpartition(".")[0] for name in words]
    outputs = (network.output_scale.strip('"'), network.output_bias.strip('"'))
    used = {*(layer.name for layer in network.layers), *network.weights, *outputs, *words}
    return {
        name: shape
        for name, shape in shapes.items()
        if not any(name == part or name.startswith(f"{part}.") for part in used if part)
        and not (len(network.layers) == 1 and not network.layers[0].name)
        and not _is_passed_over(name)
        and not (network.trainer == "brax" and name.startswith("2."))  # The critic.
    }


def _is_fed(network: TrainedNetwork, shapes: Mapping[str, Shape]) -> bool:
    """Whether other layers of the file end in as many numbers as a network takes: it is a part."""
    left = [(name, shape) for name, shape in _left(network, shapes).items() if len(shape) == 2]
    ends = {_group(name): shape[1 if "weight_hh" in name else 0] for name, shape in left}
    return network.layers[0].inputs in ends.values()


def _accounted(
    network: TrainedNetwork, shapes: Mapping[str, Shape], entries: Sequence[str]
) -> TrainedNetwork:
    """Return a network with notes of what else is in the file and has not been passed over."""
    left = _left(network, shapes)
    layers = dict.fromkeys(
        _group(name)
        for name, shape in left.items()
        if len(shape) >= 2 and not _STATISTICS.search(name)
    )
    rest = dict.fromkeys(name for name in left if _group(name) not in layers)
    rest |= dict.fromkeys(name for name in entries if not _is_passed_over(name))
    notes = [*network.notes]
    if layers:
        notes.append(
            f"the file has other networks: {_all_of(layers)}. If they feed the actor, export the "
            "policy as ONNX: this card does not run them"
        )
    if rest:
        notes.append(
            f"the card does not use these entries of the file: {_all_of(rest)}. If the policy "
            "needs them, say so in `options`, or export it as ONNX"
        )
    return replace(network, notes=tuple(notes))


def _is_passed_over(name: str) -> bool:
    """Whether an entry of a file has no effect on a policy in use."""
    match = _OTHERS.search(name)
    if match is None or not _STATISTICS.search(name):
        return match is not None
    # Statistics count unless they are a critic's, or of no observations.
    first, second, *_ = _PASSED_OVER.values()
    other = re.search(f"{first}|{second}|(count|tracked)$", name, re.IGNORECASE)
    return other is not None


def _group(name: str) -> str:
    """Return what the names of the tensors of a network begin with; another tensor's own name."""
    match = re.fullmatch(r"(.+?)[.\d]*\.(weight|kernel|bias)\w*", name)
    return match[1] if match else name


def _all_of(names: Iterable[str]) -> str:
    listed = [plain(name) for name in names]
    return ", ".join(listed[:60]) + f" and {len(listed) - 60} more" * (len(listed) > 60)


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
    outputs = {"output_scale": network.output_scale, "output_bias": network.output_bias}
    lines += [f"  {key}: {row}  # as {network.trainer}" for key, row in outputs.items() if row]
    if network.outputs is not None:
        given = network.layers[-1].outputs
        lines.append(f"  outputs: {network.outputs}  # of {given}: the others are deviations")
    said = network.normaliser_of or f"as {network.trainer}"
    if network.normaliser:
        lines.append(f"  normaliser: {network.normaliser}  # {said}")
    else:
        lines.append(f"  # normaliser: none  {CHECK} none was found in the file")
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
        files = [p for p in sorted(folder.glob("*.pkl")) if _CALLED.search(p.stem)]
        files = [p for p in files if what_is(p) == "file"]
        for path in files:
            if _CALLED.sub("", path.stem) in {checkpoint.stem, f"{checkpoint.stem}_"}:
                return path
        for path in files:
            if _CALLED.fullmatch(path.stem):
                return path
        if len(files) == 1 and folder == own and not re.search(r"\d", files[0].stem):
            return files[0]
    return None


def normalised(network: TrainedNetwork, statistics: Path | None) -> TrainedNetwork:
    """Return a network with the normaliser of a file of its own, where it has one.

    Raises:
        PolicyError: as `read_statistics`.
    """
    if statistics is None or not network.trainer.startswith("Stable-Baselines3"):
        return network
    saved = read_statistics(statistics, network.layers[0].inputs)
    if saved is None:
        return network
    return replace(network, normaliser=saved.line(), normaliser_of=saved.file)


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
    attributes = _state(rms, "stable_baselines3.common.running_mean_std.RunningMeanStd")
    mean, variance = _numbers(attributes.get("mean")), _numbers(attributes.get("var"))
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
