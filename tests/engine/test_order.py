"""The order of a run."""

from collections import Counter
from dataclasses import replace

from nw_eval.engine.order import in_order, next_place, rounds
from nw_eval.rollout.job import TrialJob
from nw_eval.suite.trials import Trial


def trials(scenes=5, count=4, suite_digest="a"):
    return [
        Trial(
            suite="s",
            suite_digest=suite_digest,
            suite_seed=1,
            scene=f"hurdles/{k}",
            scene_digest=f"{k}",
            task="hurdles",
            index=index,
        )
        for k in range(scenes)
        for index in range(count)
    ]


def test_a_run_that_is_cut_short_has_met_every_scene_about_equally_often():
    ordered = in_order(trials())
    for cut in range(1, 20):
        met = Counter(trial.scene for trial in ordered[:cut])
        counts = [met[f"hurdles/{k}"] for k in range(5)]
        assert max(counts) - min(counts) <= 1


def test_the_order_does_not_depend_on_how_trials_are_listed():
    listed = trials()
    assert in_order(reversed(listed)) == in_order(listed)


def test_rounds_and_suites_meet_the_scenes_in_different_orders():
    rounds = [tuple(t.scene for t in in_order(trials())[k : k + 5]) for k in (0, 5, 10, 15)]
    assert len(set(rounds)) > 1
    other = [trial.scene for trial in in_order(trials(suite_digest="b"))]
    assert other != [trial.scene for trial in in_order(trials())]


def test_more_trials_per_scene_leave_the_earlier_ones_where_they_were():
    few, many = in_order(trials(count=2)), in_order(trials(count=6))
    assert many[: len(few)] == few


def test_workers_share_the_scenes_out_and_meet_them_in_rounds():
    waiting = list(in_order(trials(scenes=6, count=4)))
    own, met = [set(), set()], Counter()
    loads = 0
    while waiting:
        # One worker is twice as fast as the other.
        for scenes in (own[0], own[0], own[1]):
            trial = waiting.pop(next_place(waiting, own=scenes, taken=own[0] | own[1]))
            loads += trial.scene not in scenes
            scenes.add(trial.scene)
            met[trial.scene] += 1
            assert max(met.values()) - min(met[f"hurdles/{k}"] for k in range(6)) <= 1
    # Each scene once, and again where the fast one helps out; it would be 12 without a choice.
    assert loads < 12
    assert set(met.values()) == {4}


def test_a_lone_worker_takes_trials_in_their_order():
    waiting, own, taken = list(in_order(trials())), set(), []
    while waiting:
        taken.append(waiting.pop(next_place(waiting, own=own, taken=own)))
        own.add(taken[-1].scene)
    assert [trial.index for trial in taken] == [trial.index for trial in in_order(trials())]


def test_two_workers_of_one_speed_load_each_scene_once():
    waiting = list(in_order(trials(scenes=6, count=4)))
    own = [set(), set()]
    while waiting:
        for scenes in own:
            scenes.add(waiting.pop(next_place(waiting, own=scenes, taken=own[0] | own[1])).scene)
    assert len(own[0]) == len(own[1]) == 3
    assert not own[0] & own[1]


def test_a_round_is_what_a_bank_draws_and_not_one_index():
    drawn = [replace(trial, drawn=(trial.index + len(trial.scene)) % 4) for trial in trials()]
    drawn += [replace(trial, drawn=3 - trial.drawn, perturbation=(("p", 1.0),)) for trial in drawn]
    jobs = [
        TrialJob(trial=t, robot="go1", scene=t.scene, duration=1.0, policy="p",
                 checkpoint_digest="c")
        for t in in_order(drawn)
    ]  # fmt: skip
    parts = rounds(jobs)
    assert [{job.trial.drawn for job in part} for part in parts] == [{0}, {1}, {2}, {3}]
    strata = {(t.scene, t.perturbation) for t in drawn}
    assert all({(j.trial.scene, j.trial.perturbation) for j in part} == strata for part in parts)
    waiting = [job.trial for job in jobs]
    last = waiting[-1].scene
    place = next_place(waiting, own={last}, taken=set())
    assert (waiting[place].scene, waiting[place].drawn) == (last, 0), "not of a later round"
