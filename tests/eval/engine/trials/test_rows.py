"""Rows from results."""

import json
import pickle  # noqa: TID251 - that is how jobs travel between our own processes.
from dataclasses import replace
from pathlib import Path

import pytest

from nw_base.trials import Trial
from nw_eval.engine.rows import make_row
from nw_gate.results.run_folder import RunFolder
from nw_sim.rendering import Rendering
from nw_sim.rollout.job import StageSeconds, TrialJob, TrialResult
from nw_sim.rollout.record import job_from_metadata, trial_metadata, verdict_metadata


@pytest.fixture
def job(tmp_path):
    trial = Trial(
        suite="s",
        suite_digest="d",
        suite_seed=1,
        scene="hurdles/x",
        scene_digest="e",
        task="hurdles",
        index=2,
        perturbation=(("friction", 0.6),),
        tier="critical",
    )
    return TrialJob(
        trial=trial,
        robot="go1",
        duration=12.0,
        scene="hurdles/x",
        policy="p",
        checkpoint_digest="c",
        checkpoint=tmp_path / "weights.onnx",
        mcap=tmp_path / "mcap" / "hurdles" / "x" / "t.mcap",
    )


def row(job, result, tmp_path, attempt=1):
    return make_row(job, result, attempt=attempt, policy="p", folder=RunFolder(path=tmp_path))


def test_a_result_becomes_a_row_with_its_stages_and_its_log(job, tmp_path):
    result = TrialResult(
        status="ok",
        outcome="fell",
        end_reason="roll",
        waypoints_reached=1,
        waypoints_total=4,
        waypoint_times=(2.5,),
        steps=200,
        sim_seconds=4.0,
        wall=StageSeconds(physics=0.1, render=0.2, policy=0.3, log=0.4, setup=0.05, sense=0.06),
        wall_seconds=1.5,
        mcap_bytes=77,
    )
    made = row(job, result, tmp_path)
    assert (made.outcome, made.end_reason, made.success) == ("fell", "roll", 0.25)
    assert (made.robot, made.tier) == ("go1", "critical")
    assert not made.completed
    assert (made.physics_s, made.render_s, made.policy_s, made.log_s) == (0.1, 0.2, 0.3, 0.4)
    assert (made.setup_s, made.sense_s) == (0.05, 0.06)
    assert (made.mcap_path, made.mcap_bytes) == ("mcap/hurdles/x/t.mcap", 77)
    assert made.perturbation == (("friction", 0.6),)
    assert made.seed == job.trial.seed


def test_an_error_becomes_a_row_without_a_score(job, tmp_path):
    result = TrialResult(
        status="error",
        error_type="hung",
        error_text="no result",
        waypoints_total=4,
        waypoints_reached=1,
    )
    made = row(job, result, tmp_path, attempt=2)
    assert (made.status, made.outcome, made.success, made.attempt) == ("error", "hung", None, 2)
    assert (made.mcap_path, made.error_text) == ("", "no result")


def test_an_error_of_millions_of_characters_fills_neither_row_nor_log(job, tmp_path):
    text = "::error::\x1b[2J" + "x" * 5_000_000
    result = TrialResult(status="error", error_type="policy_error", error_text=text)
    for said in (row(job, result, tmp_path).error_text, verdict_metadata(result)["error_text"]):
        assert said.startswith(r"\x3a:error::\x1b[2Jxxx")
        assert len(said) < 1100


def test_a_job_travels_to_a_worker_and_into_a_log_and_back(job):
    assert pickle.loads(pickle.dumps(job)) == job
    read = job_from_metadata(trial_metadata(job))
    assert read.trial == job.trial
    assert (read.duration, read.checkpoint, read.mcap) == (12.0, job.checkpoint, None)


def test_a_log_says_how_pictures_are_drawn_where_it_is_not_as_published(job):
    assert "rendering" not in json.loads(trial_metadata(job)["job"])
    along = replace(job, rendering=Rendering(projection="ray", samples=4, near=0.2))
    assert job_from_metadata(trial_metadata(along)).rendering == along.rendering


def test_an_older_log_says_before_its_scene_how_that_collides(job):
    metadata = trial_metadata(replace(job, scene="/my/place", collision="triangles"))
    fields = json.loads(metadata["job"])
    assert (fields["scene"], fields["collision"]) == ("/my/place", "triangles")
    del fields["collision"]
    for scene, ways in {
        "triangles:/my/place": ("/my/place", "triangles"),
        "hurdles/x": ("hurdles/x", "terrain"),
    }.items():
        read = job_from_metadata({**metadata, "job": json.dumps({**fields, "scene": scene})})
        assert (read.scene, read.collision) == ways


def test_a_log_gives_no_leave_and_no_place_to_write(job):
    metadata = trial_metadata(replace(job, allow_code=True, mcap=Path("here.mcap")))
    fields = json.loads(metadata["job"])
    assert {"allow_code", "mcap", "record"}.isdisjoint(fields)
    forged = {**fields, "allow_code": True, "mcap": "/elsewhere/there.mcap", "time_limit": 1e9}
    read = job_from_metadata({**metadata, "job": json.dumps(forged)})
    assert (read.allow_code, read.mcap, read.time_limit) == (False, None, 600.0)
    with pytest.raises(ValueError, match="damaged: policy: input should be a valid string"):
        job_from_metadata({**metadata, "job": json.dumps({**fields, "policy": 5})})


def test_a_damaged_job_in_a_log_is_one_sentence(job):
    metadata = trial_metadata(job)
    for text in ("{", "{}", "[]", '{"trial": {}}'):
        with pytest.raises(ValueError, match="damaged"):
            job_from_metadata({**metadata, "job": text})
