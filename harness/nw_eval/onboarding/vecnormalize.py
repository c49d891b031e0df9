"""What `VecNormalize` of Stable-Baselines3 saved beside a model: how observations are normalised.

`env.save("vecnormalize.pkl")` pickles the wrapper itself. It is read for its arrays alone, as all
pickles are: no class of it is imported. Its inference is
`clip((obs - mean) / sqrt(var + epsilon), -clip_obs, clip_obs)`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from nw_eval.errors import PolicyError
from nw_eval.files.inside import bounded_bytes, what_is
from nw_eval.onboarding.notation import number, plain
from nw_eval.onboarding.trained import TrainedNetwork
from nw_eval.policies.safety.objects import Record, TensorRef, read_index

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
