"""MLflow's own client finds what was written, in a store of files."""

import pytest

from nw_eval.reporting.trackers.tracked import track

SUCCESS = "nw-eval/hurdles/all/success"


@pytest.fixture
def client(at_home):  # noqa: ARG001 - it reads its variables there.
    return pytest.importorskip("mlflow").MlflowClient()


@pytest.fixture
def only_run(client):
    """Return the one run of an experiment."""

    def find(experiment="nw-eval"):
        (run,) = client.search_runs([client.get_experiment_by_name(experiment).experiment_id])
        return run

    return find


def test_a_run_of_its_own_has_verdict_scores_and_report(tracked, clip, only_run, tmp_path):
    track("mlflow", tracked(reached=3))
    run = only_run()
    assert run.info.run_name == "hurdles-go1-parkour-20261121T110005Z-01234567"
    assert run.info.status == "FINISHED"
    assert run.data.metrics[SUCCESS] == 0.75
    assert run.data.metrics["nw-eval/hurdles/success/hurdles/three_low"] == 0.75
    assert run.data.tags["nw-eval/hurdles/verdict"] == "INCONCLUSIVE"
    folder = tmp_path / "mlruns" / run.info.experiment_id / run.info.run_id / "artifacts"
    assert (folder / "nw-eval/hurdles/report.md").read_text() == "# A report\n"
    assert [file.read_bytes() for file in folder.rglob("clips/*.webp")] == [clip.data]


def test_a_second_time_updates_the_run_and_makes_no_other(tracked, client, only_run):
    track("mlflow", tracked(reached=3))
    track("mlflow", tracked(reached=3))
    history = client.get_metric_history(only_run().info.run_id, SUCCESS)
    assert [point.value for point in history] == [0.75]
    track("mlflow", tracked(reached=1))
    assert only_run().data.metrics[SUCCESS] == 0.25


def test_the_run_of_a_training_gets_the_scores_and_stays_as_it_is(
    tracked, client, only_run, monkeypatch
):
    training = client.create_run(client.create_experiment("training")).info
    client.log_metric(training.run_id, "loss", 0.5)
    monkeypatch.setenv("MLFLOW_RUN_ID", training.run_id)
    track("mlflow", tracked(reached=3))
    run = only_run("training")
    assert run.data.metrics["loss"] == 0.5
    assert run.data.metrics[SUCCESS] == 0.75
    assert run.info.status == "RUNNING"
    assert client.get_experiment_by_name("nw-eval") is None


def test_strangers_names_are_keys_of_their_own(hostile, only_run):
    track("mlflow", hostile)
    track("mlflow", hostile)
    data = only_run().data
    assert data.metrics == dict(hostile.numbers)
    assert data.tags["nw-eval/hurdles/policy"] == r"[p](http://evil) <b>`x` \x1b[31m"
