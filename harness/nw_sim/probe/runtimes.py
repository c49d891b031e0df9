"""A policy by its own runtime and by nw-eval, on the same random observations: what differs."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PolicyError, PrerequisiteError, TrialError
from nw_gate.results.provenance import depends
from nw_policies import Bundle, open_policy
from nw_policies.cards.networks import is_built_in
from nw_policies.planned import depends_on, unsupported_by
from nw_policies.policy import Observation
from nw_sim.probe.findings import ProbeFinding
from nw_sim.probe.recording import Recording

_EVERYWHERE = "its networks give the same results on every processor"
STEPS = 20
"""Actions, each with the memory of those before it."""
TOLERANCE = 1e-4
"""Of the largest number of an output; rounding comes to some 1e-6."""


@dataclass(frozen=True, kw_only=True)
class ProbedRuntimes:
    """What the same network gives that two runtimes run."""

    depends_on: str
    """What makes the policy's results depend on the processor; empty if nothing does."""
    output: str = ""
    """The output that differs most: `action`, or what a network gives."""
    difference: float | None = None
    """The largest, relative to the largest number of the output; None = not compared."""
    reason: str = ""
    """Why they were not compared."""

    @property
    def text(self) -> str:
        """What they are, in one line."""
        said = depends(self.depends_on) if self.depends_on else _EVERYWHERE
        if self.difference is None:
            return f"{said} (not compared: {self.reason})"
        return (
            f"{said}; between its own runtime and nw-eval `{self.output}` differs by at most "
            f"{self.difference:.1g} of its largest number"
        )


def is_computed(bundle: Bundle) -> bool:
    """Whether a policy is networks in files, which nw-eval may be able to run."""
    adapter = bundle.card.adapter
    return is_built_in(adapter) and adapter not in {"zero", "remote"}


def compare_runtimes(bundle: Bundle, recording: Recording) -> ProbedRuntimes:
    """Run a policy with both runtimes on random observations, and return what differs most.

    Args:
        bundle: of the policy.
        recording: of some seconds of it, in the ranges of which observations are drawn.

    Raises:
        PolicyError: the policy fails.
    """
    reason = depends_on(bundle)
    try:
        native = _run(bundle, "native", recording)
    except (PrerequisiteError, ImportError) as error:
        return ProbedRuntimes(depends_on=reason, reason=f"its own runtime is not here: {error}")
    try:
        ours = _run(bundle, "nw-eval", recording)
    except PolicyError as error:
        if not (operator := unsupported_by(error)):
            raise
        return ProbedRuntimes(depends_on=operator, reason="nw-eval does not run it")
    except TrialError as error:
        return ProbedRuntimes(
            depends_on=reason, output="action", difference=sys.float_info.max, reason=str(error)
        )
    differences = {name: _difference(native[name], ours[name]) for name in native}
    output = max(differences, key=lambda name: differences[name])
    return ProbedRuntimes(depends_on=reason, output=output, difference=differences[output])


def runtime_findings(bundle: Bundle, runtimes: ProbedRuntimes | None) -> Iterator[ProbeFinding]:
    """Yield that the two runtimes give other actions, if they do."""
    if runtimes is None or runtimes.difference is None or runtimes.difference <= TOLERANCE:
        return
    text = (
        f"`{runtimes.output}` differs by {runtimes.difference:.1g} of its largest number between "
        f"its own runtime and nw-eval; {TOLERANCE:g} is allowed"
    )
    fix = "; write `runtime: native`" if bundle.card.is_planned else ""
    yield ProbeFinding(kind="fault" if fix else "note", text=text + fix)


def _run(bundle: Bundle, runtime: str, recording: Recording) -> dict[str, NDArray[Any]]:
    """Return the actions of a policy, and what its networks give, (STEPS, ...) by name."""
    card = bundle.card.model_copy(update={"runtime": runtime})
    policy = open_policy(replace(bundle, card=card))
    given: dict[str, list[NDArray[Any]]] = {}
    try:
        policy.reset(0)
        for observation in _drawn(recording):
            given.setdefault("action", []).append(policy.act(observation))
            for name, array in getattr(policy, "held", {}).items():
                given.setdefault(name, []).append(np.array(array))
    finally:
        policy.close()
    return {name: np.stack(arrays) for name, arrays in given.items()}


def _drawn(recording: Recording) -> Iterator[Observation]:
    """Yield random observations, each number evenly between its least and its largest."""
    random = np.random.default_rng(0)
    for _ in range(STEPS):
        arrays: dict[str, NDArray[Any]] = {}
        for name, seen in recording.observations.items():
            low, high = seen.min(axis=0), seen.max(axis=0)
            drawn = low + random.random(low.shape) * (high.astype(np.float64) - low)
            arrays[name] = drawn.astype(seen.dtype)
        yield arrays


def _difference(native: NDArray[Any], ours: NDArray[Any]) -> float:
    """Return the largest difference, of the largest number; NaN is the largest that there is."""
    if native.shape != ours.shape:
        return sys.float_info.max
    if np.array_equal(native, ours, equal_nan=True):
        return 0.0
    largest = float(np.abs(native).max(initial=0.0))
    difference = float(np.abs(ours.astype(np.float64) - native).max(initial=0.0)) / (largest or 1.0)
    return difference if math.isfinite(difference) else sys.float_info.max
