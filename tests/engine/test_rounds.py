"""Rounds: who asks whether there are enough rows always asks about the same ones."""

import random
from collections import deque
from dataclasses import dataclass

import pytest

from nw_eval.engine.order import in_order
from nw_eval.engine.rounds import run_trials
from nw_eval.engine.workers.protocol import Finished
from nw_eval.results.journal import Journal, JournalHeader
from nw_eval.results.run_folder import RunFolder
from nw_eval.rollout.job import TrialJob
from nw_eval.rollout.result import TrialResult
from nw_eval.suite.model import new_suite
from nw_eval.suite.trials import expand

DONE = TrialResult(
    status="ok", outcome="completed", waypoints_reached=1, waypoints_total=1, waypoint_times=(1.0,)
)
FAILED = TrialResult(
    status="error", error_type="policy_error", end_reason="exception", error_text="it raised"
)
CRASHED = TrialResult(status="error", error_type="crashed", error_text="it died")


@dataclass(frozen=True)
class Place:
    name: str
    task: str = "flat"
    digest: str = "d"


class Office:
    """Hires workers that run nothing: `results` says what attempts come to, an order comes by lot.

    Args:
        results: what is taken for each attempt at a trial of an id; `DONE` when there is no more.
        lot: the seed of the order in which jobs that run at a time end.
    """

    again = "somewhere else"

    def __init__(self, results=None, lot=0):
        self.results = {name: list(made) for name, made in (results or {}).items()}
        self.lot = random.Random(lot)
        self.started, self.hired, self.present = [], [], 0

    def __call__(self, count, *, fresh):
        self.hired.append((count, fresh))
        return Hands(self, count)


class Hands:
    def __init__(self, office, count):
        self.office, self.count, self.queue = office, count, deque()

    def __enter__(self):
        self.office.present += 1
        return self

    def __exit__(self, *_):
        self.stop()
        self.office.present -= 1

    def submit(self, jobs):
        self.queue.extend(jobs)

    def finished(self):
        running = []
        while self.queue or running:
            while self.queue and len(running) < self.count:
                running.append(self.queue.popleft())
                self.office.started.append(running[-1].trial.id)
            yield None
            job = running.pop(self.office.lot.randrange(len(running)))
            made = self.office.results.get(job.trial.id) or [DONE]
            yield Finished(job=job, result=made.pop(0))

    def stop(self):
        self.queue.clear()


@pytest.fixture
def jobs():
    """Return jobs of three rounds in four scenes, in order."""
    scenes = [Place(f"flat/{name}") for name in ("a", "b", "c", "d")]
    suite = new_suite(
        {
            "nw-eval": 1,
            "name": "tiny",
            "robot": "go1",
            "policy": "p",
            "trials": 3,
            "seed": 1,
            "scenes": [scene.name for scene in scenes],
        }
    )
    return [
        TrialJob(trial=trial, robot="go1", scene=trial.scene, duration=1.0, policy="p",
                 checkpoint_digest="c")
        for trial in in_order(expand(suite, scenes))
    ]  # fmt: skip


@pytest.fixture
def go(tmp_path, jobs):
    """Return what runs the jobs with an office, and remembers the rows that were shown."""

    def run(office, *, stop_at=None, workers=2, resume=False, name="run", only=None):
        shown = []

        def enough(rows):
            shown.append(rows)
            return len(shown) == stop_at

        folder = RunFolder(path=tmp_path / name)
        header = JournalHeader(suite_digest="s", policy_digest="p", scene_digests={})
        open_journal = Journal.resume if resume else Journal.create
        with open_journal(folder.journal, header) as journal:
            outcome = run_trials(
                jobs[:only],
                journal=journal,
                folder=folder,
                policy="p",
                hire=office,
                workers=workers,
                enough=None if stop_at is None else enough,
            )
        return outcome, shown

    return run


def ids(jobs):
    return [job.trial.id for job in jobs]


def names(shown):
    return [[row.trial_id for row in rows] for rows in shown]


@pytest.mark.parametrize(("workers", "lot"), [(1, 0), (3, 1), (8, 2)])
def test_what_has_run_does_not_depend_on_workers_or_on_who_is_first(go, jobs, workers, lot):
    outcome, shown = go(Office(lot=lot), stop_at=2, workers=workers)
    assert names(shown) == [ids(jobs[:4]), ids(jobs[:8])]
    assert {row.trial_id for row in outcome.rows} == set(ids(jobs[:8]))
    assert (outcome.stopped_after, outcome.missing) == (2, ())


def test_no_trial_of_a_round_starts_before_the_round_before_has_ended(go, jobs):
    office = Office(results={jobs[0].trial.id: [CRASHED, DONE]})
    outcome, _ = go(office, stop_at=99, workers=8)
    again = jobs[0].trial.id
    assert set(office.started[:4]) == set(ids(jobs[:4]))
    assert office.started[4] == again, "a trial is run again in its own round"
    assert set(office.started[5:9]) == set(ids(jobs[4:8]))
    assert (outcome.stopped_after, outcome.missing, len(outcome.rows)) == (None, (), 12)


def test_after_the_last_round_nobody_is_asked(go):
    outcome, shown = go(Office(), stop_at=3)
    assert [len(rows) for rows in shown] == [4, 8]
    assert outcome.stopped_after is None


def test_rows_that_are_shown_are_the_latest_of_each_trial(go, jobs):
    failing = jobs[1].trial.id
    outcome, shown = go(Office(results={failing: [FAILED, FAILED]}), stop_at=1)
    assert [row.trial_id for row in shown[0]] == ids(jobs[:4])
    assert [row.outcome for row in shown[0]] == ["completed", "policy_failed", *["completed"] * 2]
    assert outcome.stopped_after == 1


def test_a_run_that_is_resumed_stops_where_it_would_have_stopped(go, jobs):
    go(Office(), name="cut", only=6)
    office = Office(lot=5)
    outcome, shown = go(office, stop_at=2, resume=True, name="cut")
    assert set(office.started) == set(ids(jobs[6:8]))
    assert names(shown) == [ids(jobs[:4]), ids(jobs[:8])]
    assert outcome.stopped_after == 2
    once_more, shown = go(Office(), stop_at=2, resume=True, name="cut")
    assert [len(rows) for rows in shown] == [4, 8]
    assert (once_more.stopped_after, len(once_more.rows)) == (2, 8)


def test_without_a_question_there_are_no_rounds(go, jobs):
    office = Office()
    outcome, shown = go(office, workers=5)
    assert shown == []
    assert office.started == ids(jobs), "whoever is free starts the next one"
    assert office.hired == [(5, False)]
    assert outcome.stopped_after is None


def test_workers_stay_from_round_to_round_unless_somebody_needs_their_place(go, jobs):
    calm = Office()
    go(calm, stop_at=99, name="calm")
    assert calm.hired == [(2, False)]
    troubled = Office(results={jobs[4].trial.id: [CRASHED, DONE]})
    go(troubled, stop_at=99, name="troubled")
    assert troubled.hired == [(2, False), (1, True), (2, False)]
    assert (calm.present, troubled.present) == (0, 0)


def test_a_further_attempt_keeps_its_images(go, jobs):
    records = []

    class Watching(Office):
        def __call__(self, count, *, fresh):
            hands = super().__call__(count, fresh=fresh)
            submit = hands.submit
            hands.submit = lambda jobs: (records.append([j.record for j in jobs]), submit(jobs))
            return hands

    go(Watching(results={jobs[0].trial.id: [CRASHED, DONE]}), workers=1)
    assert records == [["failures"] * 12, ["all"]]
