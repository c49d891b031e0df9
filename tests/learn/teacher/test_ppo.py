"""The arithmetic of PPO, and the network as a file."""

from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper

from nw_base.errors import PolicyError
from nw_learn.teacher.config import PpoSettings
from nw_learn.teacher.policy import Actor, Critic, new_networks, read_actor, write_actor
from nw_learn.teacher.senses import PRIVILEGED
from nw_learn.teacher.training import PpoLearner, SampleCollector, Samples, log_probability
from nw_policies import load_bundle
from nw_policies.networks.onnx_graph import open_session


def settings(**changes):
    return PpoSettings.model_validate(
        {"robots": 8, "horizon": 8, "minibatches": 2, "critic_first": 0} | changes
    )


def test_advantages_are_discounted_sums_that_end_with_their_episode():
    collector = SampleCollector(None, settings(discount=0.9, trace=0.8), None, None)
    values = np.array([[1.0], [2.0], [3.0], [4.0]], dtype=np.float32)
    earned = np.array([[1.0], [0.5], [0.2]], dtype=np.float32)
    over = np.array([[False], [True], [False]])
    third = 0.2 + 0.9 * 4.0 - 3.0
    second = 0.5 - 2.0
    first = 1.0 + 0.9 * 2.0 - 1.0 + 0.9 * 0.8 * second
    found = collector._advantages(values, earned, over)
    assert found.ravel() == pytest.approx([first, second, third])


def samples(actor, generator):
    """Return actions of a policy; those whose first number is higher were better."""
    observations = torch.randn(64, 332, generator=generator)
    means, std = actor(observations).detach(), torch.tensor(0.2)
    actions = means + std * torch.randn(64, 12, generator=generator)
    return Samples(
        observations=observations,
        privileged=torch.zeros(64, PRIVILEGED),
        actions=actions,
        means=means,
        log_probabilities=log_probability(actions, means, std),
        advantages=(actions - means)[:, 0].clone(),
        returns=torch.ones(64),
        std=std,
    )


def test_a_policy_moves_towards_what_was_better_and_its_critic_towards_what_was_earned():
    actor, critic = new_networks(1)
    generator = torch.Generator().manual_seed(0)
    learner = PpoLearner(actor, critic, settings(), generator, torch.device("cpu"))
    some = samples(actor, generator)
    figures = [learner.learn(some) for _ in range(5)]
    moved = (actor(some.observations) - some.means).mean(dim=0)
    assert moved[0] > 0.02
    assert moved[0] > 2 * moved[1:].abs().max()
    assert figures[-1]["critic/loss"] < 0.5 * figures[0]["critic/loss"]


def test_samples_of_an_older_policy_move_the_present_one_no_further_than_its_own():
    """Bounded around the older policy, an update would pull the present one back to it."""
    actor, critic = new_networks(1)
    generator = torch.Generator().manual_seed(0)
    learner = PpoLearner(actor, critic, settings(), generator, torch.device("cpu"))
    old = samples(actor, generator)
    old = replace(old, advantages=torch.randn(64, generator=generator))
    with torch.no_grad():
        actor.linear[-1].bias += 0.1  # Half a standard deviation, in every action.
    present = actor(old.observations).detach()
    divergence = learner.learn(old)["divergence/mean"]
    moved = (actor(old.observations) - present).mean().item()
    assert abs(moved) < 0.02
    assert divergence < 0.1  # From the older policy it is 12 x 0.125 = 1.5.


def test_the_critic_learns_alone_at_first():
    actor, critic = new_networks(1)
    generator = torch.Generator().manual_seed(0)
    learner = PpoLearner(actor, critic, settings(critic_first=1), generator, torch.device("cpu"))
    some, before = samples(actor, generator), actor.linear[0].weight.clone()
    assert "divergence/mean" not in learner.learn(some)
    assert (actor.linear[0].weight == before).all()
    assert "divergence/mean" in learner.learn(some)
    assert (actor.linear[0].weight != before).any()


def test_the_rate_falls_where_an_update_went_too_far_and_rises_where_it_went_nowhere():
    for target, rises in ((1e-9, False), (1e3, True)):
        actor, critic = new_networks(1)
        generator = torch.Generator().manual_seed(0)
        learner = PpoLearner(
            actor, critic, settings(divergence=target), generator, torch.device("cpu")
        )
        before = learner.rate
        learner.learn(samples(actor, generator))
        assert (learner.rate > before) == rises


def test_the_shipped_policy_is_read_without_being_run_and_written_as_the_same():
    bundle = load_bundle("go1-parkour")
    actor = read_actor(bundle.read_checkpoint(), "policy.onnx")
    rows = np.random.default_rng(3).normal(size=(4, 1, 332)).astype(np.float32)
    again = write_actor(actor)
    sessions = [open_session(data) for data in (bundle.read_checkpoint(), again)]
    for row in rows:
        first, second = (session.run(None, {"obs": row})[0] for session in sessions)
        assert (first == second).all()
        assert actor(torch.from_numpy(row)).detach().numpy() == pytest.approx(first, abs=1e-5)
    assert len(again) < 4_000_000


def test_another_network_is_refused_on_one_line():
    model = onnx.load_from_string(write_actor(Actor()))
    for tensor in model.graph.initializer:
        if list(tensor.dims) == [12]:
            tensor.CopyFrom(numpy_helper.from_array(np.zeros(11, np.float32), tensor.name))
    with pytest.raises(PolicyError) as caught:
        read_actor(model.SerializeToString(), "p.onnx")
    assert "p.onnx is not a teacher's network" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_new_networks_follow_from_the_seed_and_leave_torchs_own_generator_alone():
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    (first, _), (second, _), (other, _) = new_networks(1), new_networks(1), new_networks(2)
    assert (torch.rand(3) == expected).all()
    assert (first.linear[0].weight == second.linear[0].weight).all()
    assert (first.linear[0].weight != other.linear[0].weight).any()
    assert Critic().linear[0].in_features == 332 + PRIVILEGED
