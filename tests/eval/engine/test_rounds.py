"""A run in a drawn order: it ends with the same trial whoever runs it, and however fast."""

import os
import random
import signal
from collections import deque
from dataclasses import dataclass, replace

import pytest
from tests.trial_runs import run_trials

from nw_base.trials import expand
from nw_eval.engine.order import in_order
from nw_eval.engine.pool import Finished
from nw_eval.engine.rounds import RunStanding
from nw_eval.suite.model import new_suite
from nw_gate.results.journal import Journal, JournalHeader, read_journal
from nw_gate.results.row import rows_digest
from nw_gate.results.run_folder import RunFolder
from nw_sim.rollout.job import TrialJob, TrialResult

DONE = TrialResult(
    status="ok", outcome="completed", waypoints_reached=1, waypoints_total=1, waypoint_times=(1.0,)
)
FELL = TrialResult(status="ok", outcome="fell", waypoints_total=1)
FAILED = TrialResult(
    status="error", error_type="policy_error", end_reason="exception", error_text="it raised"
)
CRASHED = TrialResult(status="error", error_type="crashed", error_text="it died")
LOST = replace(DONE, mcap_error="the disk is full")
FALLS = (2, 5, 6, 9)
"""Places of trials that fall."""


@dataclass(frozen=True)
class Place:
    name: str
    task: str = "flat"
    digest: str = "d"


class Office:
    """Hires workers that simulate nothing; by lot one of those that run ends before the others.

    Args:
        results: what is taken for each attempt at the trial of a place; when there is no more, it
            falls at the places of `FALLS`, and is done at others.
        lot: the seed of the order in which jobs that run at a time end.
        quick: places of jobs that end before all others.
        slow: places of jobs that end after all others.
    """

    again = "somewhere else"

    def __init__(self, results=None, lot=0, quick=(), slow=()):
        self.results = {place: list(made) for place, made in (results or {}).items()}
        self.lot, self.quick, self.slow = random.Random(lot), quick, slow
        self.started, self.hired, self.present, self.most = [], [], 0, 0

    def __call__(self, count, *, fresh):
        self.hired.append((count, fresh))
        return Hands(self, count, fresh=fresh)

    def chosen(self, running):
        places = [job.trial.place for job in running]
        quick = [place for place in places if place in self.quick]
        others = [place for place in places if place not in self.slow]
        return places.index(self.lot.choice(quick or others or places))

    def result(self, job):
        made = self.results.get(job.trial.place)
        return made.pop(0) if made else FELL if job.trial.place in FALLS else DONE


class Hands:
    def __init__(self, office, count, *, fresh):
        self.office, self.count, self.fresh = office, count, fresh
        self.queue, self.running = deque(), []

    def __enter__(self):
        self.office.present += 1
        return self

    def __exit__(self, *_):
        self.stop()
        self.office.present -= 1

    def submit(self, jobs):
        self.queue.extend(jobs)
        self.office.most = max(self.office.most, len(self.queue) + len(self.running))

    def finished(self):
        while self.queue or self.running:
            while self.queue and len(self.running) < self.count:
                job = self.queue.popleft()
                self.running.append(job)
                self.office.started.append((job.trial.place, "fresh" if self.fresh else "used"))
                partial_log(job).parent.mkdir(parents=True, exist_ok=True)
                partial_log(job).write_text("begun")
            yield None
            job = self.running.pop(self.office.chosen(self.running))
            result = self.office.result(job)
            if result.status == "ok" and not result.mcap_error:
                partial_log(job).replace(job.mcap)
                result = replace(result, mcap_bytes=job.mcap.stat().st_size)
            yield Finished(job=job, result=result)

    def stop(self):
        self.queue.clear()
        self.running.clear()


class Until:
    """Finds it enough with the trial that is the n-th to fall, and with some that come later.

    Args:
        falls: n.
        followed: places of those that come later.
        waits_for: scenes that still hold a PASS back then.
    """

    def __init__(self, falls, followed=(), waits_for=()):
        self.falls, self.followed, self.asked = falls, followed, []
        self.waits_for = waits_for

    def __call__(self, ended):
        self.asked.append(dict(ended))
        first = fallen = 0
        while fallen < self.falls and first in ended:
            fallen += ended[first].outcome == "fell"
            first += 1
        is_settled = fallen == self.falls
        nexts = self.followed if is_settled else range(12)
        return RunStanding(
            first=first,
            followed=self.followed if is_settled else (),
            pending=tuple(place for place in nexts if place not in ended),
            waits_for=self.waits_for if is_settled else (),
        )


class Ears:
    """Sends this process a signal when it hears a message, or after so many trials."""

    def __init__(self, *, message=None, after=None):
        self.words, self.after, self.told = message, after, []

    def message(self, text):
        self.told.append(text)
        if self.words is not None and self.words in text:
            os.kill(os.getpid(), signal.SIGINT)

    def planned(self, *, total, finished):
        pass

    def trial(self, row):  # noqa: ARG002 - their number counts.
        if self.after is not None:
            self.after -= 1
            if self.after == 0:
                os.kill(os.getpid(), signal.SIGINT)


def partial_log(job):
    return job.mcap.with_name(f"{job.mcap.name}.partial")


def jobs_in(folder):
    """Return jobs of twelve trials in four scenes, in a drawn order."""
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
    drawn = [(scene.name, (), index) for scene in scenes for index in range(3)]
    random.Random(3).shuffle(drawn)
    return [
        TrialJob(trial=trial, robot="go1", scene=trial.scene, duration=1.0, policy="p",
                 checkpoint_digest="c", mcap=folder.mcap(trial.scene, trial.id))
        for trial in in_order(expand(suite, scenes, drawn))
    ]  # fmt: skip


@pytest.fixture
def go(tmp_path):
    """Return what runs the jobs with an office, and knows the rows of the run by place."""

    def run(office, enough=None, *, workers=2, resume=False, name="run", ears=None):
        folder = RunFolder(path=tmp_path / name)
        jobs = jobs_in(folder)
        header = JournalHeader(suite_digest="s", policy_digest="p", scene_digests={})
        open_journal = Journal.resume if resume else Journal.create
        with open_journal(folder.journal, header) as journal:
            outcome = run_trials(
                jobs,
                journal=journal,
                folder=folder,
                policy="p",
                start_workers=office,
                workers=workers,
                enough=enough,
                listener=ears,
            )
        places = {job.trial.id: job.trial.place for job in jobs}
        rows = {places[row.trial_id]: row for row in outcome.rows}
        outcome.__dict__.update(by_place=rows, folder=folder, jobs=jobs, places=places)
        assert office.present == 0
        return outcome

    return run


def judged(outcome):
    """Return the digest of the rows that are enough."""
    wanted = {*range(outcome.enough.first), *outcome.enough.followed}
    return rows_digest(row for place, row in outcome.by_place.items() if place in wanted)


def started(office):
    return [place for place, _ in office.started]


@pytest.mark.parametrize(("workers", "lot"), [(3, 1), (3, 2), (8, 3), (8, 4), (12, 5)])
def test_judged_rows_and_the_end_do_not_depend_on_workers_or_on_who_is_faster(go, workers, lot):
    alone = go(Office(), Until(3), workers=1, name="alone")
    assert alone.enough == RunStanding(first=7)
    assert sorted(alone.by_place) == [*range(7)], "one worker runs none beyond"
    rule, office = Until(3), Office(lot=lot)
    together = go(office, rule, workers=workers)
    assert any(set(ended) != {*range(len(ended))} for ended in rule.asked), "out of order"
    assert together.enough == alone.enough
    assert together.missing == ()
    assert judged(together) == judged(alone)


@pytest.mark.parametrize("workers", [1, 3, 8])
@pytest.mark.parametrize("slow", [(), (0,), (0, 1)])
def test_no_more_trials_are_given_than_there_are_workers(go, workers, slow):
    office = Office(slow=slow)
    go(office, Until(3), workers=workers)
    assert office.most == workers
    assert sorted(started(office)) == [*range(len(office.started))], "the next ones of the order"


def test_it_is_asked_before_the_first_trial_and_nobody_is_hired_in_vain(go):
    office, rule = Office(), Until(0)
    outcome = go(office, rule)
    assert rule.asked[0] == {}
    assert (outcome.enough, outcome.rows, outcome.missing) == (RunStanding(first=0), (), ())
    assert office.hired == []


def test_a_run_that_needs_every_trial_leaves_none_out(go):
    rule = Until(99)
    outcome = go(Office(), rule)
    assert set(rule.asked[-1]) == {*range(12)}
    assert (outcome.enough, outcome.missing, len(outcome.rows)) == (None, (), 12)
    settled_by_the_last = go(Office({11: [FELL]}), Until(5), name="last")
    assert (settled_by_the_last.enough, len(settled_by_the_last.rows)) == (None, 12)


def test_what_still_runs_when_it_is_enough_is_dropped_and_leaves_no_log(go):
    office = Office(slow=(6, 7, 8))
    outcome = go(office, Until(2), workers=4)
    assert outcome.enough == RunStanding(first=6)
    assert set(started(office)) == {*range(9)}
    assert set(outcome.by_place) == {*range(6)}, "the others were running"
    logs = {path.name for path in outcome.folder.path.rglob("*.mcap*")}
    assert logs == {outcome.jobs[place].mcap.name for place in range(6)}
    assert outcome.missing == ()


def test_a_trial_that_ended_beyond_what_was_enough_changes_nothing_that_is_judged(go):
    ahead = go(Office({8: [CRASHED, DONE]}, quick=(6, 7, 8), slow=(0,)), Until(2), workers=5)
    assert {6, 7} <= set(ahead.by_place)
    assert ahead.enough == RunStanding(first=6)
    assert judged(ahead) == judged(go(Office(), Until(2), workers=1, name="alone"))


def test_places_that_are_followed_run_and_those_between_them_do_not(go):
    office = Office()
    outcome = go(office, Until(2, followed=(8, 11)), workers=1)
    assert started(office) == [0, 1, 2, 3, 4, 5, 8, 11]
    assert outcome.enough == RunStanding(first=6, followed=(8, 11))
    assert (set(outcome.by_place), outcome.missing) == ({*range(6), 8, 11}, ())
    many = go(Office(lot=2), Until(2, followed=(8, 11)), workers=3, name="many")
    assert (many.enough, judged(many)) == (outcome.enough, judged(outcome))


def test_a_run_that_is_decided_and_one_that_has_no_trial_left_of_a_scene_say_so(go):
    decided, stuck = Ears(), Ears()
    go(Office(), Until(2), workers=1, ears=decided)
    assert decided.told == ["decided after 6 of 12 trials; the rest were skipped"]
    rule = Until(2, followed=(8, 11), waits_for=("flat/a",))
    go(Office(), rule, workers=1, ears=stuck, name="stuck")
    (told,) = stuck.told
    assert told == (
        "undecided after 8 trials: flat/a holds a PASS back, and no trial of it is left; --resume "
        "with more --trials runs more"
    )


def test_a_followed_place_that_a_signal_cut_off_is_missing_no_more_once_it_is_resumed(go):
    rule = Until(2, followed=(8, 11))
    cut = go(Office(), rule, workers=1, ears=Ears(after=7))
    assert (cut.enough, cut.interrupted, len(cut.rows)) == (None, signal.SIGINT, 7)
    office = Office()
    resumed = go(office, rule, workers=1, resume=True)
    assert started(office) == [11]
    assert resumed.enough == RunStanding(first=6, followed=(8, 11))


@pytest.mark.parametrize("first", [CRASHED, FAILED])
def test_the_place_of_an_error_counts_once_it_is_settled(go, first):
    rule = Until(3)
    office = Office({1: [first, first if first is FAILED else DONE]}, quick=(1,))
    outcome = go(office, rule, workers=3)
    shown = [ended[1] for ended in rule.asked if 1 in ended]
    assert {(row.status, row.attempt) for row in shown} == {("ok", 2)}
    assert shown[0].outcome == ("policy_failed" if first is FAILED else "completed")
    assert outcome.enough == RunStanding(first=7)


@pytest.mark.parametrize("workers", [1, 2, 3, 8])
def test_nothing_further_starts_until_a_trial_that_ended_in_an_error_has_run_again(go, workers):
    office = Office({1: [CRASHED, DONE]}, quick=(1,))
    outcome = go(office, Until(3), workers=workers)
    repeated = office.started.index((1, "fresh"))
    assert set(started(office)[:repeated]) <= {*range(1 + workers)}
    assert outcome.enough == RunStanding(first=7)
    assert office.hired[:2] == [(workers, False), (1, True)]


def test_an_error_beyond_what_is_enough_is_not_run_again(go):
    office = Office({4: [CRASHED]}, quick=(4,), slow=(0,))
    outcome = go(office, Until(1), workers=5)
    assert outcome.enough == RunStanding(first=3)
    assert office.hired == [(5, False)]
    assert outcome.by_place[4].status == "error"
    assert outcome.missing == ()


@pytest.mark.parametrize("workers", [1, 3, 8])
def test_a_run_that_is_resumed_ends_where_it_would_have_ended(go, workers):
    whole = go(Office(), Until(3), workers=1, name="whole")
    cut = go(Office(lot=7), Until(3), workers=4, name="cut", ears=Ears(after=4))
    assert (cut.interrupted, cut.enough, len(cut.rows)) == (signal.SIGINT, None, 4)
    assert {*range(12)} - {*cut.by_place} == {cut.places[name] for name in cut.missing}
    office = Office(lot=5)
    resumed = go(office, Until(3), workers=workers, resume=True, name="cut")
    assert not {*started(office)} & {*cut.by_place}, "what has a result does not run again"
    assert (resumed.enough, judged(resumed)) == (whole.enough, judged(whole))
    idle = Office()
    once_more = go(idle, Until(3), workers=workers, resume=True, name="cut")
    assert idle.started == []
    assert (once_more.enough, judged(once_more)) == (whole.enough, judged(whole))


def test_a_signal_stops_what_runs_and_says_of_no_trial_that_it_need_not_run(go):
    office = Office()
    cut = go(office, Until(3), workers=4, ears=Ears(after=2))
    assert len(office.started) > len(cut.rows) == 2
    assert (cut.interrupted, cut.enough, len(cut.missing)) == (signal.SIGINT, None, 10)


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_what_a_signal_kept_from_its_second_attempt_has_it_in_a_fresh_process(go, workers):
    cut = go(
        Office({3: [FAILED]}, quick=(3,)), Until(3), workers=4, ears=Ears(message="will run again")
    )
    assert set(cut.by_place) == {3}
    office = Office({3: [FAILED]})
    resumed = go(office, Until(3), workers=workers, resume=True)
    assert [how for place, how in office.started if place == 3] == ["fresh"]
    assert set(started(office)[: started(office).index(3)]) <= {*range(3 + workers)}
    assert (resumed.by_place[3].outcome, resumed.by_place[3].attempt) == ("policy_failed", 2)
    assert resumed.enough == RunStanding(first=7)


@pytest.mark.parametrize("workers", [1, 3])
def test_a_trial_that_lost_its_log_runs_again_and_its_result_stands(go, workers):
    first = go(Office({1: [LOST]}), Until(3), workers=1)
    assert first.by_place[1].lost_its_log
    office = Office({1: [FELL]})
    resumed = go(office, Until(3), workers=workers, resume=True)
    assert 1 in started(office)
    assert (resumed.enough, judged(resumed)) == (first.enough, judged(first))
    mended = go(Office(), Until(3), workers=workers, resume=True)
    assert not mended.by_place[1].lost_its_log
    assert (mended.enough, judged(mended)) == (first.enough, judged(first))


def test_what_was_enough_is_in_the_journal_when_it_is_said(go):
    outcome = go(Office(lot=3), Until(3), workers=3)
    kept = read_journal(outcome.folder.journal).rows
    assert {row.trial_id for row in kept} == {row.trial_id for row in outcome.rows}


def test_without_a_question_every_trial_runs_and_whoever_is_free_starts_the_next(go):
    office = Office()
    outcome = go(office, workers=5)
    assert started(office) == [*range(12)]
    assert office.hired == [(5, False)]
    assert outcome.enough is None


def test_workers_stay_unless_somebody_needs_their_memory(go):
    calm = Office()
    go(calm, Until(99), name="calm")
    assert calm.hired == [(2, False)]
    troubled = Office({4: [CRASHED, DONE]})
    go(troubled, Until(99), name="troubled")
    assert troubled.hired == [(2, False), (1, True), (2, False)]


def test_a_further_attempt_keeps_its_images(go):
    records = []

    class Watching(Office):
        def __call__(self, count, *, fresh):
            hands = super().__call__(count, fresh=fresh)
            submit = hands.submit
            hands.submit = lambda jobs: (records.append([j.record for j in jobs]), submit(jobs))
            return hands

    go(Watching({0: [CRASHED, DONE]}), workers=1)
    assert records == [["failures"] * 12, ["all"]]
