"""Sim-to-real agreement: results on the robot beside runs and banks. Needs no simulation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.stats.agreement import Agreement


def agree(real: str | Path, runs: Sequence[str | Path], *, confidence: float = 0.95) -> Agreement:
    """Say how well the simulator ranks policies as the robot does.

    Args:
        real: a CSV with the columns policy, scene, trials and success (0 to 1). A policy is named
            as in its run, or by the name of its run's folder or its bank.
        runs: folders of runs, and banks by path or, beside a run, by name; others than the CSV's
            policies may be among them.
        confidence: of each interval.

    Raises:
        UsageError: the CSV is none, or names a policy or scene that no run has; there is no run;
            or the confidence is not between 0 and 1.
        IncomparableError: the runs differ in suite, scenes or simulator; each field is named.
        StoreError: rows are damaged.
    """
    from nw_eval.api.running.comparisons import check_share, entrants
    from nw_eval.errors import UsageError
    from nw_eval.gate.side_by_side import measured
    from nw_eval.results.real import read_real_results
    from nw_eval.stats.agreement import agreement

    check_share(confidence)
    if not runs:
        raise UsageError("no run to compare the robot with", fix="name the runs of its policies")
    return agreement(measured(read_real_results(Path(real)), entrants(runs)), confidence)
