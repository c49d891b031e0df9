"""Results on the robot beside those of the same policies in the simulator."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nw_eval.errors import UsageError, nearest
from nw_eval.gate.side_by_side.entrant import Entrant, check_alike
from nw_eval.results.real import RealResult
from nw_eval.stats.agreement.agree import Measured


def measured(real: Sequence[RealResult], entrants: Sequence[Entrant]) -> list[Measured]:
    """Return each policy's success in the two worlds, over the scenes that it met on the robot.

    Scenes weigh equally. As trials count as many as would leave a mean that uncertain in one scene:
    S^2 / (1 / n_1 + .. + 1 / n_S).

    Args:
        real: of the robot.
        entrants: of the simulator, at least one.

    Raises:
        UsageError: a policy or scene of the robot's is none of the simulator's, or is two.
        IncomparableError: the simulator's differ in suite, scenes or simulator.
    """
    check_alike(entrants)
    policies: dict[str, list[RealResult]] = {}
    for each in real:
        policies.setdefault(each.policy, []).append(each)
    return [
        _measured(policy, results, _entrant(results[0], entrants))
        for policy, results in policies.items()
    ]


def _measured(policy: str, results: Sequence[RealResult], entrant: Entrant) -> Measured:
    simulated: list[list[float]] = []
    for each in results:
        scores = [
            float(result.success or 0.0)
            for name, result in entrant.results.items()
            if name[0] == each.scene
        ]
        if not scores:
            raise UsageError(
                f"{each.place}: {entrant.source} has no result in scene {each.scene!r}",
                fix=nearest(each.scene, entrant.key.scenes),
            )
        simulated.append(scores)
    return Measured(
        policy=policy,
        real=float(np.mean([each.success for each in results])),
        real_trials=_effective([each.trials for each in results]),
        simulated=float(np.mean([np.mean(scores) for scores in simulated])),
        simulated_trials=_effective([len(scores) for scores in simulated]),
    )


def _entrant(result: RealResult, entrants: Sequence[Entrant]) -> Entrant:
    """Return the one that a line of the robot's means: by its policy's name, or by its own."""
    known = {_own(each) for each in entrants} | {each.policy for each in entrants}
    found = [each for each in entrants if result.policy == _own(each)] or [
        each for each in entrants if result.policy == each.policy
    ]
    if not found:
        raise UsageError(
            f"{result.place}: policy {result.policy!r} is that of no run",
            fix=nearest(result.policy, known),
        )
    if len(found) > 1:
        raise UsageError(
            f"{result.place}: policy {result.policy!r} may be {found[0].source} or "
            f"{found[1].source}",
            fix="call it by the name of its run's folder",
        )
    return found[0]


def _own(entrant: Entrant) -> str:
    """Return the name of a run's folder, or of a bank without its suffix."""
    return Path(entrant.source).name.removesuffix(".parquet")


def _effective(trials: Sequence[int]) -> int:
    return max(1, round(len(trials) ** 2 / sum(1.0 / n for n in trials)))
