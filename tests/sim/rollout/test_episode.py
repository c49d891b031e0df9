"""An episode runs its own loop; whoever looks on sees each step at three places."""

import pytest

from nw_base.errors import TrialError
from nw_sim.rollout.episode import Observer
from nw_sim.rollout.job import StageClock
from nw_sim.rollout.opening import open_trial


class Notes(Observer):
    """An observer that notes what it is shown, and where the robot is then."""

    def __init__(self, episode):
        self.episode = episode
        self.calls = []
        self.steps = []

    def before(self):
        self.calls.append(("before", self.episode.step))

    def decided(self, decision):
        self.calls.append(("decided", self.episode.step))
        self.decision = decision

    def advanced(self, step):
        assert step.decision is self.decision
        self.calls.append(("advanced", self.episode.step))
        self.steps.append(step)


@pytest.fixture
def opened(make_job, library):
    """Return a trial of 0.2 s: ten control steps."""
    with open_trial(make_job(duration=0.2), library, StageClock()) as trial:
        yield trial.episode


@pytest.fixture(scope="module")
def end(make_job, library):
    """Return how that trial ends when nobody looks on, with its digests."""
    with open_trial(make_job(duration=0.2), library, StageClock()) as trial:
        outcome = trial.episode.run()
        return outcome, trial.episode.state_digest.hex, trial.episode.action_digest.hex


def test_every_observer_sees_each_step_begin_then_decided_then_made(opened):
    first, second = Notes(opened), Notes(opened)
    assert opened.run(first, second) == "timeout"
    expected = [
        call
        for step in range(10)
        for call in (("before", step), ("decided", step), ("advanced", step + 1))
    ]
    assert first.calls == second.calls == expected
    assert [step.outcome for step in first.steps] == [None] * 9 + ["timeout"]


def test_who_looks_on_changes_nothing(opened, end):
    outcome = opened.run(Notes(opened))
    assert (outcome, opened.state_digest.hex, opened.action_digest.hex) == end


def test_an_episode_that_is_left_in_its_middle_goes_on_from_there(opened, end):
    for step in opened.steps():
        assert step.outcome is None
        if opened.step == 4:
            break
    outcome = opened.run()
    assert opened.step == 10
    assert (outcome, opened.state_digest.hex, opened.action_digest.hex) == end


def test_a_state_without_one_of_its_parts_or_with_a_short_one_is_refused(opened):
    state = opened.state()
    names = [part.name for part in state.parts]
    assert {"trail", "termination", "delay", "applied", "coverage"} < set(names)
    state.parts[names.index("applied")].data = bytes(8 * 11)
    with pytest.raises(TrialError, match="the recorded state of step 0 does not fit this trial"):
        opened.restore(state)
    del state.parts[names.index("applied")]
    with pytest.raises(TrialError, match=r"does not fit this trial: KeyError\('applied'\)"):
        opened.restore(state)
