"""Trajectories: trials as every other, beside which the one who does not drive looks on."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from student_parts import small_config

from nw_learn.student.card import BODY, DEPTH_STEPS
from nw_learn.student.drive import Pair
from nw_learn.student.driving import Driving, plan_round
from nw_learn.student.network import StudentNetwork, write_policy
from nw_learn.student.train import body_size
from nw_learn.student.trajectory import read_trajectory
from nw_policies import load_bundle
from nw_sim.catalogue import FoundScene
from nw_sim.rollout.episode import Observer
from nw_sim.rollout.job import StageClock
from nw_sim.rollout.library import Library
from nw_sim.rollout.opening import open_trial
from nw_sim.rollout.trial import run_trial

SCENE = "hurdles/one_low_carpet"


@pytest.fixture(scope="module")
def eyes():
    """Sees depth: nothing needs to be drawn."""
    return small_config()


@pytest.fixture(scope="module")
def student(eyes, teacher, tmp_path_factory):
    folder = tmp_path_factory.mktemp("student")
    torch.manual_seed(1)
    network = StudentNetwork(eyes.network, eyes.sees, proprio=body_size(eyes, teacher))
    write_policy(folder, network, eyes, teacher.card)
    return load_bundle(folder)


@pytest.fixture
def planned(eyes, student, teacher, tmp_path):
    def plan(number, config=eyes):
        scenes = [FoundScene.at(SCENE)]
        folder = tmp_path / f"round-{number}"
        folder.mkdir(exist_ok=True)
        return plan_round(number, config, scenes, folder, student=student, teacher=teacher)

    return plan


class Seen(Observer):
    def __init__(self):
        self.decisions = []

    def decided(self, decision):
        kept = {name: np.array(value) for name, value in decision.observation.items()}
        self.decisions.append(decision._replace(observation=kept))


def evaluated(job):
    """Return what an evaluation of the same trial shows its policy."""
    seen = Seen()
    with open_trial(job, Library(), StageClock()) as trial:
        trial.episode.run(seen)
    return seen.decisions


@pytest.mark.parametrize("number", [1, 2])
def test_a_trajectory_is_bit_for_bit_the_trial_of_an_evaluation(planned, student, teacher, number):
    job = planned(number).jobs[0]
    pair = Pair(student=student.reference, teacher=teacher.reference)
    driven, run = pair(job), run_trial(replace(job, mcap=None))
    assert driven.status == run.status == "ok", driven.error_text
    assert (driven.state_digest, driven.action_digest) == (run.state_digest, run.action_digest)
    assert driven.steps == run.steps == read_trajectory(job.mcap).steps


def test_the_student_drives_all_rounds_but_the_first(planned, student, teacher):
    assert {job.policy for job in planned(1).jobs} == {teacher.reference}
    assert {job.policy for job in planned(2).jobs} == {student.reference}


def test_the_teachers_share_falls_from_round_to_round(eyes, planned, teacher):
    config = eyes.model_copy(update={"teacher_share": 0.5, "trajectories": 8})
    driven = [
        sum(job.policy == teacher.reference for job in planned(number, config).jobs)
        for number in (1, 2, 3, 4)
    ]
    assert driven == [8, 4, 2, 1]


def test_a_network_to_start_with_drives_from_the_first_round_on(eyes, planned, student, teacher):
    config = eyes.model_copy(update={"start": "weights.pt"})
    assert {job.policy for job in planned(1, config).jobs} == {student.reference}
    config = config.model_copy(update={"teacher_share": 0.5, "trajectories": 8})
    driven = [
        sum(job.policy == teacher.reference for job in planned(number, config).jobs)
        for number in (1, 2, 3)
    ]
    assert driven == [4, 2, 1]


def test_no_round_begins_as_another_one_or_as_an_evaluation(planned):
    seeds = {job.trial.seed for number in (1, 2, 3) for job in planned(number).jobs}
    assert len(seeds) == 6


def test_a_student_that_drives_is_recorded_as_it_saw_the_world(planned, student, teacher):
    job = planned(2).jobs[0]
    Pair(student=student.reference, teacher=teacher.reference)(job)
    one = read_trajectory(job.mcap)
    decisions = evaluated(job)
    body = [np.concatenate([seen.observation[name] for name in BODY]) for seen in decisions]
    np.testing.assert_array_equal(one.body, np.stack(body))
    for decision, frame in zip(decisions, one.frame_of, strict=True):
        stack = one.depth[[max(frame - 1, 0), frame], 0] / DEPTH_STEPS
        np.testing.assert_allclose(decision.observation["depth"], stack, atol=1e-6)
    assert one.frame_of[-1] == (one.steps - 1) // 5  # 10 Hz.


def test_a_teacher_that_looks_on_says_what_it_would_do_if_it_drove(planned, student, teacher):
    driven_by_teacher = planned(1).jobs[0]
    Pair(student=student.reference, teacher=teacher.reference)(driven_by_teacher)
    one = read_trajectory(driven_by_teacher.mcap)
    decisions = evaluated(driven_by_teacher)
    np.testing.assert_array_equal(one.labels, np.float32([d.action for d in decisions]))
    # Its first answer is to the start alone, whoever drives; so is what the student sees there.
    driven_by_student = replace(
        driven_by_teacher,
        policy=student.reference,
        checkpoint_digest=student.checkpoint_digest,
        mcap=driven_by_teacher.mcap.with_name("other.npz"),
    )
    Pair(student=student.reference, teacher=teacher.reference)(driven_by_student)
    other = read_trajectory(driven_by_student.mcap)
    np.testing.assert_array_equal(one.labels[0], other.labels[0])
    np.testing.assert_array_equal(one.body[0], other.body[0])
    np.testing.assert_array_equal(one.depth[0], other.depth[0])
    assert not np.array_equal(one.labels[20], other.labels[20])


def test_the_teacher_is_asked_about_the_states_that_the_student_comes_to(
    planned, student, teacher, monkeypatch
):
    """The student's card, driven by the teacher's network, gives the teacher's own labels."""
    job = planned(1).jobs[0]
    pair = Pair(student=student.reference, teacher=teacher.reference)
    pair(job)
    by_teacher = read_trajectory(job.mcap)
    labels = iter(by_teacher.labels.astype(np.float64))

    class Obeys:
        inputs = ()

        def reset(self, seed):
            pass

        def act(self, _):
            return next(labels)

        def close(self):
            pass

    monkeypatch.setattr("nw_sim.rollout.opening.open_policy", lambda *_, **__: Obeys())
    by_student = replace(job, policy=student.reference, checkpoint_digest=student.checkpoint_digest)
    result = pair(by_student)
    assert result.status == "ok", result.error_text
    again = read_trajectory(job.mcap)
    np.testing.assert_allclose(again.labels, by_teacher.labels, atol=1e-5)
    np.testing.assert_allclose(again.body, by_teacher.body, atol=1e-5)


def test_driving_goes_on_with_what_is_missing_and_ends_where_the_bytes_do(
    eyes, planned, monkeypatch
):
    trajectories = planned(1, eyes.model_copy(update={"trajectories": 3}))
    said = []
    driving = Driving(trajectories, say=said.append, most=1, workers=1)
    assert driving.run(lambda: False)
    # The worker has the second one already when the first is counted, and may end it. The third it
    # is never given.
    assert [job.trial.index for job in trajectories.missing][-1] == 2
    assert Driving(trajectories, say=said.append, most=10**9, workers=1).run(lambda: False)
    assert not trajectories.missing
    assert "round 1: 3 of 3 trajectories driven" in said[-1]
    monkeypatch.setattr("nw_learn.student.driving.LocalWorkers", None)
    assert Driving(trajectories, say=said.append, most=10**9).run(lambda: False)
