"""Filters of actions, against their published coefficients and the Butterworth response itself."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from nw_base.errors import PolicyError
from nw_policies import ActionFilter, load_bundle
from nw_policies.cards import Card, JointControl, load_card
from nw_policies.cards.control import ButterworthFilter, ExponentialFilter
from nw_scenes.robots import get_robot
from nw_sim.probe.recording import record

GO1 = get_robot("go1")


def made(low_pass, **control):
    """The filter of a card, and the control that scales what it returns."""
    fields = {"action": "joint_position_offset", "scale": 0.25, "filter": low_pass} | control
    card = Card.model_validate(
        {"nw-policy": 1, "name": "c", "robot": "go1", "adapter": "zero", "control": fields}
    )
    control = JointControl.from_card(card, GO1)
    return ActionFilter.from_card(card, control), control


def exponential(alpha):
    return {"kind": "exponential", "alpha": alpha}


def butterworth(cutoff, **order):
    return {"kind": "butterworth", "cutoff": cutoff, **order}


@pytest.mark.parametrize(
    ("step", "b", "a"),
    [
        # What people wrote down of scipy.signal.butter(2, 4.0 / nyquist), as constants in their
        # deployment code: one at 0.033 s, one at 0.03 s for an action.
        (0.033, [0.10669309, 0.21338618, 0.10669309], [1.0, -0.88771945, 0.31449182]),
        (0.030, [0.0913, 0.1826, 0.0913], [1.0, -0.9824, 0.3477]),
    ],
)
def test_butterworth_has_the_published_coefficients(step, b, a):
    found = ButterworthFilter(kind="butterworth", cutoff=4.0).coefficients(1.0 / step)
    digits = 1e-8 if step == 0.033 else 5e-5
    np.testing.assert_allclose(found, [b, a], atol=digits)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("cutoff", [0.1, 4.0, 20.0])
def test_butterworth_is_flat_as_its_name_promises(order, cutoff):
    b, a = ButterworthFilter(kind="butterworth", cutoff=cutoff, order=order).coefficients(50)
    frequencies = np.linspace(0.0, 24.9, 50)
    z = np.exp(-2j * np.pi * frequencies[:, np.newaxis] / 50 * np.arange(order + 1))
    power = np.abs(z @ b / (z @ a)) ** 2
    # The analog filter's 1 / (1 + (w / w_c)^2N), at the frequencies that the transform warps.
    ratio = np.tan(np.pi * frequencies / 50) / np.tan(np.pi * cutoff / 50)
    np.testing.assert_allclose(power, 1.0 / (1.0 + ratio ** (2 * order)), atol=1e-5)
    assert np.abs(np.roots(a)).max() < 1.0


def test_exponential_smoothing_is_its_formula():
    smoother, _ = made(exponential(0.3))
    actions = np.random.default_rng(0).normal(size=(20, 12))
    expected = np.zeros(12)
    for action in actions:
        expected = 0.3 * action + 0.7 * expected
        np.testing.assert_allclose(smoother.push(action), expected, rtol=1e-12)


@pytest.mark.parametrize("weights", [[1.0], [0.5, 0.3, 0.2], [0.9, -0.1, 0.0, 0.2]])
def test_a_fir_filter_is_the_weighted_sum_of_the_last_actions(weights):
    smoother, _ = made({"kind": "fir", "weights": weights})
    actions = np.random.default_rng(0).normal(size=(20, 12))
    expected = lfilter(weights, 1.0, actions, axis=0)
    found = [smoother.push(action).copy() for action in actions]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


def test_butterworth_is_the_recursion_over_earlier_actions_and_outputs():
    smoother, _ = made(butterworth(4.0, order=3))
    b, a = ButterworthFilter(kind="butterworth", cutoff=4.0, order=3).coefficients(50)
    x = np.random.default_rng(1).normal(size=(30, 12))
    y = np.zeros_like(x)
    for n in range(30):
        y[n] = sum(b[k] * x[n - k] for k in range(4) if n >= k)
        y[n] -= sum(a[k] * y[n - k] for k in range(1, 4) if n >= k)
        np.testing.assert_allclose(smoother.push(x[n]), y[n], atol=1e-12)


@pytest.mark.parametrize("low_pass", [exponential(0.2), butterworth(2.0)])
@pytest.mark.parametrize("action", ["joint_position_offset", "joint_position"])
def test_it_starts_at_rest_in_the_default_pose(low_pass, action):
    smoother, control = made(low_pass, action=action)
    rest = (control.default_pose - control.base) / control.scale
    for _ in range(5):
        targets = control.targets(smoother.push(rest))
        np.testing.assert_allclose(targets, GO1.default_pose, atol=1e-12)


def test_torques_start_at_none():
    smoother, _ = made(exponential(0.5), action="joint_torque")
    np.testing.assert_array_equal(smoother.push(np.ones(12)), np.full(12, 0.5))


def test_actions_are_limited_before_they_are_filtered():
    smoother, _ = made(exponential(0.5), clip=2.0)
    assert smoother.push(np.full(12, 100.0)).tolist() == [1.0] * 12


def test_where_a_filter_overshoots_the_limits_hold_behind_it_too():
    smoother, control = made(butterworth(10.0), clip=2.0)
    made_of_it = [smoother.push(np.full(12, 2.0)) for _ in range(20)]
    assert np.max(made_of_it) > 2.02
    targets = np.array([control.targets(action) for action in made_of_it])
    assert (targets - GO1.default_pose).max() == pytest.approx(0.5)


def test_a_filter_goes_back_to_its_state():
    smoother, _ = made(butterworth(5.0, order=2))
    actions = np.random.default_rng(2).normal(size=(9, 12))
    for action in actions[:4]:
        smoother.push(action)
    state = smoother.state()
    after = [smoother.push(action) for action in actions[4:]]
    smoother.restore(state)
    np.testing.assert_array_equal([smoother.push(action) for action in actions[4:]], after)


def test_a_cutoff_beyond_half_the_rate_is_an_error_with_its_line(tmp_path):
    (tmp_path / "policy.yaml").write_text(
        "nw-policy: 1\nname: c\nrobot: go1\nadapter: zero\ncontrol:\n"
        "  action: joint_position_offset\n  rate: 25\n"
        "  filter: {kind: butterworth, cutoff: 12.5}\n"
    )
    with pytest.raises(PolicyError) as caught:
        load_card(tmp_path / "policy.yaml")
    assert "policy.yaml:8:3: control.filter: a cutoff of 12.5 Hz" in str(caught.value)
    assert "give less than 12.5, or remove `filter`" in str(caught.value)


@pytest.fixture(scope="module")
def walked():
    """A function: the shipped policy on flat ground for three seconds, with a filter."""
    bundle = load_bundle("go1-parkour")

    def walked(low_pass):
        control = bundle.card.control.model_copy(update={"filter": low_pass})
        card = bundle.card.model_copy(update={"control": control})
        return record(replace(bundle, card=card), scene="flat/carpet_room", seconds=3.0)

    return walked


def test_alpha_one_is_no_filter_to_the_last_bit(walked):
    plain, filtered = walked(None), walked(ExponentialFilter(kind="exponential", alpha=1.0))
    np.testing.assert_array_equal(filtered.positions, plain.positions)
    np.testing.assert_array_equal(filtered.targets, plain.targets)


@pytest.mark.parametrize(
    "low_pass",
    [
        ExponentialFilter(kind="exponential", alpha=0.5),
        ButterworthFilter(kind="butterworth", cutoff=10.0),
    ],
    ids=["exponential", "butterworth"],
)
def test_the_shipped_policy_walks_behind_a_mild_filter_that_smooths_its_targets(walked, low_pass):
    plain, filtered = walked(None), walked(low_pass)
    assert not filtered.stumbles
    assert filtered.travelled > 0.8 * plain.travelled > 1.5
    roughness = [np.abs(np.diff(one.targets, axis=0)).mean() for one in (filtered, plain)]
    assert roughness[0] < 0.95 * roughness[1]


def test_it_does_not_walk_behind_one_that_takes_its_steps_away(walked):
    assert walked(ExponentialFilter(kind="exponential", alpha=0.05)).stumbles


def test_what_the_policy_sees_of_its_actions_is_not_filtered(walked):
    filtered = walked(ExponentialFilter(kind="exponential", alpha=0.5))
    seen = filtered.observations["last_output"]
    np.testing.assert_array_equal(seen[1:], filtered.actions[:-1].astype(np.float32))
