"""A run's folder as `nw-eval run` leaves it, but for its logs: written without a simulator."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from nw_eval.api.running.saved_run import saved_suite, saved_trials
from nw_eval.results.ended import write_trials
from nw_eval.results.journal import Journal, JournalHeader
from nw_eval.results.provenance import write_run_info
from nw_eval.results.run_folder import RunFolder

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row


def write_run(path: Path, run: RunInfo, rows: Iterable[Row]) -> Path:
    """Write a run that has ended with these rows; their seeds become those of its trials."""
    folder = RunFolder(path=path)
    path.mkdir(parents=True, exist_ok=True)
    seeds = {trial.id: trial.seed for trial in saved_trials(run, saved_suite(run))}
    kept = [replace(row, seed=seeds[row.trial_id]) for row in rows]
    header = JournalHeader(
        suite_digest=run.suite_digest,
        policy_digest=run.policy.card_digest,
        scene_digests={name: scene.digest for name, scene in run.scenes.items()},
        engine=run.engine,
    )
    with Journal.create(folder.journal, header) as journal:
        for row in kept:
            journal.append(row)
    write_run_info(folder.run_json, write_trials(folder, run, kept))
    return path
