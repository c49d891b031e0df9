"""A run takes over what is known, but for a few trials, and only if these agree."""

from dataclasses import replace
from random import Random

import pytest
from cache_parts import DONE, Office, conditions_of, jobs_of, row_of
from tests.trial_runs import run_trials

from nw_eval.engine import machine
from nw_eval.engine.known import KnownTrials
from nw_eval.engine.rounds import RunStanding
from nw_gate.results.journal import Journal, JournalHeader
from nw_gate.results.row import rows_digest
from nw_gate.results.run_folder import RunFolder
from nw_sim.rollout.job import TrialResult

HERE = conditions_of()
FELL = replace(DONE, outcome="fell", waypoints_reached=0, waypoint_times=())
CRASHED = TrialResult(status="error", error_type="crashed", error_text="it died")
RAISED = replace(CRASHED, error_type="policy_error", end_reason="exception")


@pytest.fixture
def go(store, tmp_path):
    """Return what runs trials into a folder with what is known, and tells all of it."""

    def run(
        name,
        *,
        trials=4,
        results=None,
        first=None,
        workers=1,
        resume=False,
        seed=0,
        hold=True,
        conditions=HERE,
        **names,
    ):
        folder = RunFolder(path=tmp_path / name)
        office, told, shown = Office(results), [], []

        class Ears:
            message = told.append

            def planned(self, **_):
                pass

            def trial(self, row):
                shown.append(row.trial_id)

        known = KnownTrials(
            store,
            conditions,
            still_hold=lambda: hold,
            folder=folder,
            policy=names.get("policy", "p"),
            arm="candidate",
            say=told.append,
            doubted=lambda: told.append("doubted"),
            chance=Random(seed),
        )
        header = JournalHeader(suite_digest="s", policy_digest="p", scene_digests={})
        opened = Journal.resume if resume else Journal.create
        with opened(folder.journal, header) as journal:
            outcome = run_trials(
                jobs_of(
                    folder,
                    trials=trials,
                    scenes=names.get("scenes", ("flat/a",)),
                    is_drawn=first is not None,
                ),
                journal=journal,
                folder=folder,
                policy=names.get("policy", "p"),
                start_workers=office,
                workers=workers,
                enough=None if first is None else enough_after(first, trials),
                listener=Ears(),
                known=known,
            )
        assert sorted(shown) == sorted(set(shown))
        outcome.__dict__.update(office=office, told=told, info=known.info, folder=folder)
        return outcome

    return run


def enough_after(count, trials):
    """Return what finds it enough once the first trials of a drawn order have ended, so many."""

    def enough(ended):
        first = next(place for place in range(count + 1) if place not in ended or place == count)
        nexts = () if first == count else range(trials)
        return RunStanding(
            first=first, pending=tuple(place for place in nexts if place not in ended)
        )

    return enough


def judged(outcome, first):
    """Return the digest of the rows of the first trials of the order."""
    return rows_digest(row for row in outcome.rows if row.seed_index < first)


def hits(outcome):
    return [row.seed_index for row in outcome.rows if row.cached]


def test_a_run_that_is_repeated_runs_one_trial_and_has_the_same_results(go):
    first, again = go("first"), go("again")
    assert len(first.office.started) == 4
    assert len(again.office.started) == 1
    assert rows_digest(again.rows) == rows_digest(first.rows)
    assert len(hits(again)) == 3
    assert again.info.reexecuted == 1
    assert not again.told


def test_what_is_taken_over_is_written_together_and_shown_when_it_is_on_disk(go, monkeypatch):
    go("first", trials=20)
    together, extend = [], Journal.extend

    def counted(journal, rows):
        extend(journal, rows)
        together.append(len(rows))
        assert {row.trial_id for row in rows} <= {row.trial_id for row in journal.rows}

    monkeypatch.setattr(Journal, "extend", counted)
    again = go("again", trials=20)
    assert together == [1, 19]  # What ran, and all that it confirmed.
    assert len(hits(again)) == 19


def test_what_is_taken_over_has_its_log_in_the_run_and_the_times_of_its_own_run(go):
    go("first")
    again = go("again")
    for row in again.rows:
        log = again.folder.path / row.mcap_path
        assert log.read_text() == f"the log of {row.trial_id}"
        assert log.stat().st_nlink == (2 if row.cached else 1)
        assert log.is_relative_to(again.folder.cached if row.cached else again.folder.logs)
        assert row.wall_s == 2.0


def test_more_trials_run_only_those_that_are_new(go):
    go("first")
    more = go("more", trials=10)
    assert len(more.office.started) == 6 + 1
    assert sorted(hits(more) + [int(name[-3:]) for name in more.office.started]) == [*range(10)]


def test_results_are_found_under_other_names_of_suite_policy_and_scene(go):
    go("first", scenes=("flat/a",))
    again = go("again", scenes=("flat/renamed",), policy="renamed")
    assert len(again.office.started) == 1
    for row in again.rows:
        assert (row.scene, row.policy) == ("flat/renamed", "renamed")
        assert row.trial_id == f"flat-renamed-{row.seed_index:03d}"
        assert (
            row.mcap_path
            == f"{'cached' if row.cached else 'mcap'}/flat/renamed/{row.trial_id}.mcap"
        )


def test_other_conditions_know_nothing(go):
    go("first")
    assert len(go("again", conditions=conditions_of(policy="other")).office.started) == 4


def test_which_trials_run_again_is_chance(go):
    go("first", trials=6)
    drawn = {go(f"again{seed}", trials=6, seed=seed).office.started[0] for seed in range(12)}
    assert len(drawn) > 3


def test_two_of_a_hundred_run_again(go):
    go("first", trials=100)
    for seed in range(3):
        again = go(f"again{seed}", trials=100, seed=seed)
        assert len(again.office.started) == again.info.reexecuted == 2
        assert len(hits(again)) == 98


def test_the_longest_of_those_that_run_again_comes_first(go):
    names = [f"flat-a-{number:03d}" for number in range(200)]
    steps = {name: 50 + number * 37 % 200 for number, name in enumerate(names)}
    results = {name: [replace(DONE, steps=count)] for name, count in steps.items()}
    go("first", trials=200, results=results)
    again = go("again", trials=200, results=results).office.started
    assert len(again) == 4
    assert again == sorted(again, key=steps.__getitem__, reverse=True)
    assert again != sorted(again)


@pytest.mark.parametrize("workers", [1, 3])
def test_in_a_drawn_order_the_first_runs_again_and_later_ones_may(go, workers):
    go("first", trials=100)
    again = go("again", trials=100, first=90, workers=workers, seed=3)
    assert again.enough == RunStanding(first=90)
    places = [int(name[-3:]) for name in again.office.started]
    assert places[0] in range(workers)
    assert len(places) == len({*places}) == again.info.reexecuted
    assert 1 < len(places) < 8


@pytest.mark.parametrize("workers", [1, 3])
def test_the_end_and_the_rows_are_those_of_a_run_without_the_cache(go, workers):
    first = go("first", trials=8, first=5)
    again = go("again", trials=8, first=5, workers=workers)
    assert (first.enough, again.enough) == (RunStanding(first=5), RunStanding(first=5))
    assert judged(first, 5) == judged(again, 5)
    assert again.missing == ()
    assert len(hits(again)) == 4


@pytest.mark.parametrize("workers", [1, 3, 8])
def test_what_was_not_needed_in_the_end_leaves_no_log_of_the_cache(go, workers):
    go("first", trials=12)
    again = go("again", trials=12, first=4, workers=workers)
    logs = {path.name for path in again.folder.cached.rglob("*") if path.is_file()}
    assert logs == {f"{row.trial_id}.mcap" for row in again.rows if row.cached}


def test_what_still_waits_when_it_is_enough_leaves_no_log_of_the_cache(go):
    # The first is not kept, for it has run twice. Of the others one runs again, and the last waits.
    go("first", trials=3, results={"flat-a-000": [CRASHED, DONE]})
    crash = {f"flat-a-{i:03d}": [CRASHED] for i in (1, 2)}
    again = go("again", trials=3, first=1, workers=3, results=crash)
    assert again.enough == RunStanding(first=1)
    assert len(again.office.started) == 2
    assert [path for path in again.folder.cached.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("workers", [1, 3])
def test_a_run_in_a_drawn_order_that_goes_on_ends_where_it_would_have_ended(go, workers):
    whole = go("whole", trials=8, first=6)
    go("cut", trials=3, first=3, conditions=conditions_of(policy="elsewhere"))
    resumed = go("cut", trials=8, first=6, resume=True, workers=workers)
    assert resumed.enough == whole.enough
    assert judged(resumed, 6) == judged(whole, 6)
    assert len(hits(resumed)) >= 2


def test_a_result_that_differs_voids_all_and_nothing_is_taken_over(go):
    go("first", trials=5)
    wrong = {f"flat-a-{i:03d}": [FELL] for i in range(5)}
    again = go("again", trials=5, results=wrong)
    assert len(again.office.started) == 5
    assert hits(again) == []
    assert [path for path in again.folder.cached.rglob("*") if path.is_file()] == []
    assert {row.outcome for row in again.rows} == {"fell"}
    [sentence] = again.info.differing
    assert f"trial {again.office.started[0]} has another result" in sentence
    assert "fell after 50 steps" in sentence
    assert "in the cache completed" in sentence
    assert again.told == [f"{sentence}; 5 entries of the cache voided", "doubted"]
    later = go("later", trials=5, results=wrong)  # The true ones were kept in their place.
    assert len(later.office.started) == 1
    assert later.info.differing == ()


def test_what_differs_later_in_a_drawn_order_ends_the_use_of_the_cache(go):
    go("first", trials=100)
    # The first trial agrees; then whatever runs comes out otherwise.
    wrong = {f"flat-a-{i:03d}": [FELL] for i in range(1, 100)}
    again = go("again", trials=100, first=100, results=wrong, seed=3)
    assert again.info.differing
    bad = [int(name[-3:]) for name in again.office.started]
    assert bad[1:] == [*range(bad[1], 100)]
    assert len(again.rows) == 100


@pytest.mark.parametrize("workers", [1, 2, 3, 8])
def test_what_waited_for_a_result_that_differs_runs_before_anything_further(go, workers):
    go("first", trials=40)
    wrong = {f"flat-a-{i:03d}": [FELL] for i in range(40)}
    again = go("again", trials=40, first=10, workers=workers, results=wrong)
    assert again.enough == RunStanding(first=10)
    assert hits(again) == []
    assert {row.outcome for row in again.rows} == {"fell"}
    assert len(again.rows) < 10 + workers
    assert len(again.info.differing) == 1


@pytest.mark.parametrize("workers", [1, 3])
def test_an_errors_trial_holds_a_drawn_order_and_is_compared_when_it_has_run_again(go, workers):
    go("first", trials=8)
    crash = {f"flat-a-{i:03d}": [CRASHED, DONE] for i in range(8)}
    again = go("again", trials=8, first=5, workers=workers, results=crash)
    assert again.enough == RunStanding(first=5)
    assert again.office.started[0] == again.office.started[1], "before anything further"
    assert hits(again) == [i for i in range(5) if f"flat-a-{i:03d}" not in again.office.started]


def test_an_errors_trial_is_compared_when_it_has_run_again(go):
    go("first")
    crash = {f"flat-a-{i:03d}": [CRASHED, DONE] for i in range(4)}
    again = go("again", results=crash)
    assert len(again.office.started) == 2
    assert again.info.reexecuted == 1
    assert len(hits(again)) == 3


def test_where_nothing_could_be_compared_everything_runs(go):
    go("first")
    crash = {f"flat-a-{i:03d}": [CRASHED, CRASHED] for i in range(4)}
    again = go("again", results=crash)
    assert [row.status for row in again.rows] == ["error"] * 4
    assert hits(again) == []


def test_a_trial_that_ended_in_an_error_runs_when_its_run_goes_on(go):
    go("first")
    broken = {f"flat-a-{i:03d}": [CRASHED, CRASHED] for i in range(4)}
    go("again", results=broken)
    resumed = go("again", resume=True)
    assert len(resumed.office.started) == 4
    assert resumed.info.reexecuted == 4


def test_a_run_that_goes_on_takes_over_what_it_lacks(go):
    go("all", trials=8)
    go("part", trials=3, conditions=conditions_of(policy="elsewhere"))
    resumed = go("part", trials=8, resume=True)
    assert len(resumed.office.started) == 1
    assert len(resumed.rows) == 8


def test_errors_and_policies_that_failed_and_second_attempts_are_not_kept(go):
    results = {"flat-a-000": [CRASHED] * 2, "flat-a-001": [RAISED] * 2,
               "flat-a-002": [CRASHED, DONE]}  # fmt: skip
    first = go("first", results=results)
    outcomes = {row.seed_index: (row.outcome, row.attempt) for row in first.rows}
    assert outcomes == {0: ("crashed", 2), 1: ("policy_failed", 2), 2: ("completed", 2),
                        3: ("completed", 1)}  # fmt: skip
    again = go("again")
    assert {*again.office.started} == {f"flat-a-{i:03d}" for i in range(4)}
    assert again.info.reexecuted == 1


def test_nothing_is_kept_once_the_policy_on_disk_is_another(go):
    go("first", hold=False)
    assert len(go("again").office.started) == 4


def test_a_log_that_is_damaged_is_run_again_and_mended(go, store):
    go("first")
    for kept in list(store):
        (kept.path / "log.mcap").unlink()
        (kept.path / "log.mcap").write_text("foreign")
    assert len(go("again").office.started) == 4
    assert len(go("later").office.started) == 1


def test_a_cache_that_cannot_be_written_is_one_sentence_and_no_failure(go, store):
    store.folder.write_text("no folder")
    first = go("first")
    assert len(first.rows) == 4
    [message] = first.told
    assert message.startswith(f"results are not kept for later runs: {store.folder} cannot be")


def test_an_interrupted_run_takes_over_nothing_that_was_not_compared(go, monkeypatch):
    go("first")
    real = machine.Interrupts.__enter__

    def heard(self):
        real(self)
        self.requested = machine.signal.SIGINT
        return self

    monkeypatch.setattr(machine.Interrupts, "__enter__", heard)
    cut = go("again")
    assert (cut.rows, len(cut.missing)) == ((), 4)
    monkeypatch.undo()
    resumed = go("again", resume=True)
    assert len(resumed.office.started) == 1
    assert len(resumed.rows) == 4


def test_a_row_that_was_tampered_with_and_sealed_again_contradicts_its_trial(go, store, tmp_path):
    go("first")
    folder = RunFolder(path=tmp_path / "forged")
    for job in jobs_of(folder, trials=4):
        forged = replace(row_of(job, folder), seed=job.trial.seed + 1)
        store.put(HERE, HERE.key(job), forged, job.mcap)
    assert len(go("again").office.started) == 4
