"""MLflow: on the run that `MLFLOW_RUN_ID` names, or on one of its own, found again by its tag."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from nw_eval.reporting.trackers.tracked import PROJECT, TrackedRun

_TAG = f"{PROJECT}.run"
_PATIENCE = {"MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1", "MLFLOW_HTTP_REQUEST_TIMEOUT": "10"}
"""Of a server that is down it is said in seconds: MLflow's own 7 tries of 120 s take minutes."""
_AT_ONCE = 500
"""Metrics of one request; servers take 1,000."""


def track(run: TrackedRun) -> None:
    """Show a run where `MLFLOW_TRACKING_URI` and the like say.

    Words are tags, since a parameter that was set once cannot be set again.

    Raises:
        mlflow.MlflowException: the store cannot be reached, or refuses.
    """
    for name, value in _PATIENCE.items():
        os.environ.setdefault(name, value)
    mlflow: Any = import_module("mlflow")
    entities = mlflow.entities
    client = mlflow.MlflowClient()
    of_others = os.environ.get("MLFLOW_RUN_ID")
    run_id = of_others or _own(client, run)
    client.log_batch(run_id, tags=[entities.RunTag(key, text) for key, text in run.words.items()])
    # Of points of one step the latest is shown: one that says nothing new is not added.
    there, now = client.get_run(run_id).data.metrics, _ms(datetime.now(tz=UTC))
    metrics = [
        entities.Metric(key, number, now, run.step or 0)
        for key, number in run.numbers.items()
        if run.step is not None or there.get(key) != number
    ]
    for first in range(0, len(metrics), _AT_ONCE):
        client.log_batch(run_id, metrics=metrics[first : first + _AT_ONCE])
    for file in run.files:
        client.log_artifact(run_id, str(file), artifact_path=run.place)
    with TemporaryDirectory() as folder:
        for name, clip in run.clips.items():
            Path(folder, name).write_bytes(clip.data)
            client.log_artifact(run_id, str(Path(folder, name)), artifact_path=f"{run.place}/clips")
    if not of_others:
        client.set_terminated(run_id, "FINISHED", end_time=_ms(run.ended))


def _own(client: Any, run: TrackedRun) -> str:
    """Return the id of the run that an earlier call made, or of a new one."""
    experiment = _experiment(client)
    found = client.search_runs([experiment], f"tags.`{_TAG}` = '{run.id}'", max_results=1)
    if found:
        return found[0].info.run_id
    tags = {_TAG: run.id}
    created = client.create_run(experiment, _ms(run.begun), tags=tags, run_name=run.title)
    return created.info.run_id


def _experiment(client: Any) -> str:
    if named := os.environ.get("MLFLOW_EXPERIMENT_ID"):
        return named
    name = os.environ.get("MLFLOW_EXPERIMENT_NAME") or PROJECT
    found = client.get_experiment_by_name(name)
    return client.create_experiment(name) if found is None else found.experiment_id


def _ms(time: datetime) -> int:
    return int(time.timestamp() * 1000)
