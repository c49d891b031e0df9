"""Another policy takes over a recorded trial from exactly its state, knowing what it has seen."""

import numpy as np
import pytest

from nw_base.errors import StoreError, UsageError
from nw_base.trials import Trial
from nw_eval import api
from nw_eval.cli.verbs.replay import takeover_page
from nw_policies import load_bundle
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.physics import Actuators
from nw_sim.rollout.driven import driven, packed_programs, unpacked_programs
from nw_sim.rollout.job import TrialJob
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.record import attachments
from nw_sim.rollout.replaying import policy_switch
from nw_sim.rollout.replaying.takeover import replay, take_over
from nw_sim.rollout.trial import run_trial

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # Of torch.jit.


def bits(result):
    return result.outcome, result.steps, result.state_digest, result.action_digest


def last_state(path):
    state = LogReader(path).states()[-1]
    state.ClearField("timestamp")
    return state


@pytest.mark.parametrize("start", [0.0, 0.5, 0.98])
def test_the_same_policy_takes_over_and_nothing_changes(walked, library, start):
    path, result = walked
    taken = take_over(path, start=start, library=library)
    assert bits(taken.result) == bits(result)
    assert taken.result.waypoint_times == result.waypoint_times
    assert taken.report.is_identical
    assert "the same, bit for bit" in takeover_page(taken.report)


NIGHTLY = pytest.mark.nightly


@pytest.mark.parametrize(
    ("kind", "start", "protocol"),
    [
        ("remembering", 0.26, "strict"),
        ("seeing", 0.26, "neverwhere-2026"),
        pytest.param("remembering", 0.5, "neverwhere-2026", marks=NIGHTLY),
        pytest.param("seeing", 0.5, "strict", marks=NIGHTLY),
    ],
)
def test_memories_cameras_rates_latencies_and_filters_are_where_they_were(
    record, library, request, tmp_path, kind, start, protocol
):
    path, result = record(request.getfixturevalue(kind), duration=0.6, protocol=protocol)
    new = tmp_path / "new.mcap"
    taken = take_over(path, start=start, library=library, out=new)
    assert bits(taken.result) == bits(result)
    # Every part of the last state: what the policy and each sensor remember, what is on its way.
    assert last_state(new) == last_state(path)


def test_another_policy_goes_another_way_from_there_on_and_twice_the_same(
    walked, library, remembering, tmp_path
):
    path, result = walked
    logs = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    first, second = (
        take_over(path, start=0.5, policy=remembering, library=library, out=log) for log in logs
    )
    assert bits(first.result) == bits(second.result)
    assert logs[0].read_bytes() == logs[1].read_bytes()
    assert not first.report.is_identical
    assert first.result.state_digest != result.state_digest
    was, now = (
        {step.step: list(step.targets) for *_, step in LogReader(log).messages("/nw/policy")}
        for log in (path, logs[0])
    )
    assert [was[step] == now[step] for step in (0, 24)] == [True, True]
    # Its latency is two of its periods: until then it sends what the first one had asked for.
    assert was[30] != now[30]


def test_the_log_of_a_taken_over_trial_is_replayed_from_itself(
    walked, library, remembering, tmp_path
):
    new = tmp_path / "new.mcap"
    taken = take_over(walked[0], start=0.5, policy=remembering, library=library, out=new)
    for start, begins in ((0.0, 25), (0.3, 25), (0.8, 40)):
        again = replay(new, start=start, library=library)
        assert again.is_identical
        assert again.start_step == begins
        assert bits(again.result) == bits(taken.result)
    back = take_over(new, start=0.2, policy="go1-parkour", library=library)
    assert bits(back.result) == bits(walked[1])
    with pytest.raises(
        UsageError, match="switched to another policy in control step 25 already; give an earlier"
    ):
        take_over(new, start=0.6, policy="go1-parkour", library=library)


def test_motors_that_remember_are_where_they_were(record, library, networked, tmp_path):
    path, result = record(networked, duration=0.6)
    again = replay(path, start=0.3, library=library)
    assert again.is_identical
    new = tmp_path / "new.mcap"
    taken = take_over(path, start=0.26, library=library, out=new)
    assert bits(taken.result) == bits(result)
    assert last_state(new) == last_state(path)


def test_policies_of_other_motors_take_over_from_each_other(
    walked, record, library, networked, tmp_path
):
    for path, policy in ((walked[0], networked), (record(networked)[0], "go1-parkour")):
        new = tmp_path / f"{path.parent.name}.mcap"
        first = take_over(path, start=0.5, policy=policy, library=library, out=new)
        second = take_over(path, start=0.5, policy=policy, library=library)
        assert bits(first.result) == bits(second.result)
        assert not first.report.is_identical
        # Its log has both networks: that of the policy which began, and its own.
        assert replay(new, library=library).is_identical
        assert replay(new, start=0.8, library=library).is_identical


def test_a_log_without_the_networks_of_its_motors_is_refused(library, networked):
    card = library.bundle(networked, None).card
    robot = get_robot("go1")
    for data in (b"", b"damaged", packed_programs(())):
        with pytest.raises(StoreError, match=r"here.mcap: it holds no network of the motors"):
            driven(Actuators.of(robot), card, robot, unpacked_programs(data, "here.mcap"))


def test_taking_over_at_the_start_is_a_trial_of_ones_own(walked, make_job, library, remembering):
    own = run_trial(make_job(policy=remembering, duration=1.0), library=library)
    taken = take_over(walked[0], start=0.0, policy=remembering, library=library)
    assert bits(taken.result) == bits(own)


def test_the_page_says_who_took_over_when_and_how_both_ended(walked, library):
    page = takeover_page(take_over(walked[0], start=0.5, policy="stand", library=library).report)
    head, was, now = page.splitlines()
    assert head.endswith("stand takes over from go1-parkour (1d9068e0) at 0.50 s")
    assert was.startswith("  was  timeout (time) at 1.00 s, 1 of 2 waypoints, at x ")
    assert now.startswith("  now  timeout (time) at 1.00 s, 1 of 2 waypoints, at x ")
    assert was[5:] != now[5:]


def test_a_trial_that_goes_another_way_here_is_not_taken_over(walked, library, monkeypatch):
    def pushed(log, *, joints):
        for count, decided in enumerate(decisions(log, joints=joints)):
            yield decided._replace(targets=decided.targets + 1e-9 * (count == 7))

    decisions = policy_switch.decisions
    monkeypatch.setattr(policy_switch, "decisions", pushed)
    with pytest.raises(StoreError, match=r"does not go its recorded way here, its state at 0.20 s"):
        take_over(walked[0], start=0.5, library=library)


def test_a_log_without_a_card_says_so(make_job, library, tmp_path):
    path = tmp_path / "trial.mcap"
    run_trial(make_job(mcap=path, duration=0.2), library=library)
    with pytest.raises(StoreError, match=r"holds no card of the policy that made it.*nw-eval run"):
        take_over(path, start=0.1, library=library)


@pytest.mark.parametrize(
    ("start", "words"),
    [(-1.0, "--from -1; give seconds"), (1.0, "--from 1: .* ends at 1 s; give less")],
)
def test_a_time_outside_the_trial_is_refused(walked, library, start, words):
    with pytest.raises(UsageError, match=words):
        take_over(walked[0], start=start, library=library)


def test_numbers_of_a_log_that_are_none_are_refused(walked, library, monkeypatch):
    broken = LogReader.messages

    def without_one(self, *topics):
        for topic, time, message in broken(self, *topics):
            if topic == "/nw/policy" and message.step == 3:
                message.targets[4] = np.nan
            yield topic, time, message

    monkeypatch.setattr(LogReader, "messages", without_one)
    with pytest.raises(StoreError, match="does not record what was applied in control step 3"):
        take_over(walked[0], start=0.5, library=library)


def test_a_confined_process_takes_over_and_writes_the_new_log(tmp_path):
    scene, bundle = get_scene("flat/carpet_room"), load_bundle("go1-parkour")
    log, new = tmp_path / "trial.mcap", tmp_path / "out" / "new.mcap"
    result = run_trial(
        TrialJob(
            trial=Trial(
                suite="test",
                suite_digest="0" * 64,
                suite_seed=11,
                scene=scene.name,
                scene_digest=scene.digest,
                task=scene.task,
                index=0,
            ),
            robot="go1",
            duration=0.4,
            scene=scene.name,
            policy="go1-parkour",
            policy_name=bundle.name,
            checkpoint_digest=bundle.checkpoint_digest,
            record="none",
            mcap=log,
            attachments=attachments(bundle.card_text, ""),
        )
    )
    taken = api.take_over(log, start=0.2, policy="stand", out=new)
    assert taken.log == new
    assert taken.was.digests == (result.state_digest, result.action_digest)
    assert taken.now.digests != taken.was.digests
    assert LogReader(new).metadata()["nw.verdict"]["state_digest"] == taken.now.digests[0]
    assert [each.name for each in new.parent.iterdir()] == ["new.mcap"]


def test_a_damaged_word_of_a_take_over_is_said_to_be(walked, library, monkeypatch):
    whole = LogReader(walked[0]).attachments()
    torn = {**whole, "takeover.json": b'{"step": "\\u202e soon"}'}
    monkeypatch.setattr(LogReader, "attachments", lambda _: torn)
    with pytest.raises(
        StoreError, match=r"its attachment takeover.json is damaged: .*valid integer"
    ):
        replay(walked[0], library=library)
