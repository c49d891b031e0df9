"""Attribution finds the last moment of a failed trial from which a baseline completes it."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from nw_base.errors import IncomparableError, StoreError, UsageError
from nw_eval import api
from nw_eval.api.attribution import baseline_bundle
from nw_eval.cli.verbs.attribute import attribution_page, forecast_line, trial_line, written
from nw_policies import load_bundle
from nw_sim.rollout.replaying import takeover as searching
from nw_sim.rollout.replaying.reports import AttributionReport, Ending, Try
from nw_sim.rollout.replaying.takeover import attribute, most_tries, search, take_over

WAS = Ending(
    policy="new",
    end="collided",
    reason="contact face",
    waypoints="1 of 4",
    steps=246,
    control_rate=50,
    position=None,
    digests=("a", "b"),
)


@pytest.mark.parametrize("last", [0, 1, 77, 498])
def test_the_search_finds_the_last_moment_where_there_is_one_change(last):
    tried = search(range(500), lambda step: step <= last)
    assert max(step for step, holds in tried.items() if holds) == last
    assert len(tried) <= most_tries(500)
    assert list(tried) == sorted(tried)


def test_the_search_tries_evenly_first_and_so_sees_what_is_not_monotone():
    tried = search(range(401), lambda step: 150 <= step < 230)
    assert [tried[step] for step in (0, 50, 100, 150, 200, 250)] == [False] * 3 + [True] * 2 + [
        False
    ]
    assert max(step for step, holds in tried.items() if holds) == 229


@pytest.mark.parametrize("holds", [True, False])
def test_where_nothing_changes_the_even_ones_are_all(holds):
    assert set(search(range(0, 90, 3), lambda _: holds).values()) == {holds}
    assert len(search(range(300), lambda _: holds)) == searching.COARSE + 1
    assert search([7], lambda _: holds) == {7: holds}


def tries(*words):
    return tuple(
        Try(step=step, end="completed" if good else "fell", reason="", steps=step + 100)
        for step, good in words
    )


def attributed(*words):
    report = AttributionReport(
        trial="t-001", was=WAS, baseline="old", tries=tries(*words), stride=1
    )
    return api.AttributedTrial(trial="t-001", scene="t", report=report)


def test_the_sentence_says_when_and_how_long_before_what():
    line = trial_line(attributed((0, True), (216, True), (217, False), (245, False)))
    assert line == "t-001: committed at 4.32 s, 0.60 s before contact face"


def test_a_baseline_that_fails_the_start_too_is_said_to():
    line = trial_line(attributed((0, False), (100, False)))
    assert "not only the candidate's fault: old fails from the start, too (fell at 2.00 s)" in line


def test_what_is_not_monotone_is_said_to_be():
    line = trial_line(attributed((0, True), (50, False), (100, True), (150, False)))
    assert "not monotone: completes from 0.00 s, fails from 1.00 s" in line
    assert "completes again from 2.00 s, fails from 3.00 s" in line
    assert "from the start, too" not in line
    late = trial_line(attributed((0, False), (100, True), (150, False)))
    assert "fails from 0.00 s, completes from 2.00 s, fails" in late
    assert late.endswith("old fails from the start, too")


def test_a_baseline_that_saves_it_until_the_end_is_said_to():
    assert "completes from all of 2 moments, 4.90 s too" in trial_line(
        attributed((0, True), (245, True))
    )


def test_files_hold_every_try_and_the_page_a_table():
    plan = api.AttributionPlan(
        chosen=2, failed=5, without_log=1, baseline="old", tries=14, minutes=1.5, workers=2
    )
    lost = api.AttributedTrial(trial="t-002", scene="t", report=None, fault="it is damaged")
    attribution = api.Attribution(
        run="r", plan=plan, trials=(attributed((0, True), (216, False)), lost)
    )
    assert "2 more are skipped; --trials 4 includes them" in forecast_line(plan)
    assert "1 failed trial without a log" in forecast_line(plan)
    read = json.loads(written(attribution, ".json"))
    assert [each["committed_s"] for each in read["trials"]] == [0.0, None]
    assert len(read["trials"][0]["report"]["tries"]) == 2
    row = "| t-001 | collided (contact face) | 4.92 s | 0.00 s | 4.92 s |"
    assert row in " ".join(written(attribution, ".md").split())
    assert attribution_page(attribution).splitlines()[-1] == "t-002: it is damaged"


def test_one_who_stands_still_is_lost_when_there_is_no_time_left(record, library, monkeypatch):
    monkeypatch.setattr(searching, "COARSE", 2)
    path, result = record("stand", duration=4.0)
    assert not result.waypoints_reached
    report = attribute(path, policy="go1-parkour", library=library)
    assert report.was.digests == (result.state_digest, result.action_digest)
    assert report.is_monotone
    # It walks 2.5 m at 0.8 m/s, and needs about a second less than there is.
    last = report.committed
    assert 0.3 < last.step * 0.02 < 1.5
    late = next(each for each in report.tries if each.step == last.step + 1)
    assert report.stride == 1
    for each in (last, late):  # Each try is what a take-over at that moment gives.
        taken = take_over(path, start=each.step * 0.02, policy="go1-parkour", library=library)
        assert (each.end, each.steps) == (taken.result.outcome, taken.result.steps)
    assert (last.end, late.completes) == ("completed", False)


HASTY = """\
nw-eval: 1
name: hasty
robot: go1
policy: stand
trials: 1
seed: 7
episode: {duration: 2.0}
scenes: [hurdles/one_low_carpet]
expect:
  gentle: {reading: joint_rate, at_most: 8, longer_than: 0.02}
"""


@pytest.mark.slow
def test_when_limits_were_first_passed_is_said_of_the_trial_and_of_the_baselines(tmp_path):
    (tmp_path / "hasty.yaml").write_text(HASTY)
    logs = {}
    for policy in ("stand", "go1-parkour"):
        run = api.run(
            tmp_path / "hasty.yaml", policy=policy, baseline="none", out=tmp_path / policy,
            workers=1,
        )  # fmt: skip
        logs[policy] = tmp_path / policy / run.rows[0].mcap_path
    (found,) = api.attribute(tmp_path / "stand", baseline="go1-parkour", workers=1).trials
    moments = {
        policy: api.log_scores(log, scores=["expect_gentle", "limit_time"]).moments
        for policy, log in logs.items()
    }
    assert found.report.limits == moments["stand"]
    assert found.report.tries[0].limits == moments["go1-parkour"]
    when = moments["go1-parkour"]["expect_gentle"]
    own = moments["stand"].get("expect_gentle")
    told = "never" if own is None else f"at {own:.3f} s"
    said = f"expect_gentle {told} (by {found.report.baseline} at {when:.3f} s)"
    assert said in trial_line(found)
    assert moments["stand"] != moments["go1-parkour"]


def test_of_a_trial_that_measures_no_scores_no_limit_is_told():
    assert "limits" not in trial_line(attributed((0, True), (216, False)))


def test_the_scores_of_a_trial_that_was_taken_over_are_of_all_of_it(record, library):
    path, result = record("go1-parkour", scores=("mean_power", "action_rate"), duration=2.0)
    taken = take_over(path, start=1.0, policy="go1-parkour", library=library)
    assert taken.report.is_identical
    assert taken.result.scores == result.scores


def run_of(suite):
    return SimpleNamespace(suite={"name": suite})


def test_a_baseline_s_name_means_its_policy_and_only_that(tmp_path):
    info = run_of("hurdles")
    mine = load_bundle("go1-parkour")
    found = baseline_bundle("go1-parkour", info, policy=None, checkpoint=None)
    assert found.digest == mine.digest
    other = tmp_path / "other.onnx"
    other.write_bytes(mine.checkpoint.read_bytes() + b"\n")
    with pytest.raises(IncomparableError, match=r"was saved with go1-parkour \(1d9068e0\), and"):
        baseline_bundle("go1-parkour", info, policy=None, checkpoint=other)


def test_where_there_is_no_baseline_a_policy_is_meant():
    info = run_of("smoke-of-mine")
    assert baseline_bundle("stand", info, policy=None, checkpoint=None).name == "stand"
    with pytest.raises(UsageError, match="has no baseline 'nobody', and no policy"):
        baseline_bundle("nobody", info, policy=None, checkpoint=None)
    with pytest.raises(UsageError, match="has no baseline 'stand'"):
        baseline_bundle("stand", info, policy="go1-parkour", checkpoint=None)


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises((StoreError, UsageError), match=str(tmp_path)):
        api.attribute(tmp_path, baseline="stand")


def weakened(path: Path, noise: float) -> Path:
    """Write the shipped checkpoint with noise on its weights; as bad as one pleases."""
    model = onnx.load(load_bundle("go1-parkour").checkpoint)
    rng = np.random.default_rng(7)
    for weights in model.graph.initializer:
        array = numpy_helper.to_array(weights)
        if array.ndim == 2 and array.size > 500:
            moved = array + noise * array.std() * rng.standard_normal(array.shape)
            weights.CopyFrom(numpy_helper.from_array(moved.astype(array.dtype), weights.name))
    onnx.save(model, path)
    return path


@pytest.mark.nightly
def test_real_failures_of_a_weakened_checkpoint_are_attributed(tmp_path):
    weak = weakened(tmp_path / "weak.onnx", 0.25)
    request = api.Request(
        suite="hurdles",
        policy="go1-parkour",
        checkpoint=weak,
        scenes=("hurdles/one_low_carpet", "hurdles/three_low"),
        trials=3,
        baseline="none",
    )
    report = api.run(request, out=tmp_path / "run")
    failed = [row for row in report.rows if not row.completed]
    assert failed
    attribution = api.attribute(tmp_path / "run", baseline="go1-parkour")
    assert [each.trial for each in attribution.trials]
    assert len(attribution.trials) == len(failed)
    found = [each.report for each in attribution.trials]
    assert all(found)
    saved = [each for each in found if each.committed is not None and each.is_monotone]
    assert saved
    logs = {row.trial_id: tmp_path / "run" / row.mcap_path for row in failed}
    for each in saved[:2]:
        after = min(one.step for one in each.tries if one.step > each.committed.step)
        assert after == each.committed.step + each.stride
        at, late = (
            api.take_over(logs[each.trial], start=step * 0.02, policy="go1-parkour").now.end
            for step in (each.committed.step, after)
        )
        assert at == "completed"
        assert late != "completed"
