"""An encoder and a policy in one arena: the bits of networks that are asked one by one."""

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from nw_base.errors import TrialError
from nw_policies import load_bundle, open_policy
from nw_policies.fed_policy import FedPolicy
from nw_policies.one_plan import OnePlan

CARD = """nw-policy: 1
name: fed
robot: go1
adapter: onnx
checkpoint: {{file: body.onnx}}
control: {{action: joint_position_offset, scale: 0.25}}
networks:
  late: {{adapter: onnx, checkpoint: {{file: late.onnx}}, inputs: {{x: [{takes}]}}{late}}}
  early: {{adapter: onnx, checkpoint: {{file: early.onnx}}, inputs: {{x: [speeds]}}{rate}}}
inputs: {{x: [pose, {given}, early]}}
observations:
  pose: {{sensor: proprio, terms: [joint_pos]}}
  speeds: {{sensor: proprio, terms: [joint_vel]}}
"""


def graph(inputs, outputs, *, seed, memory=None, kind=TensorProto.FLOAT):
    """tanh(x @ w [+ h_in]); with a memory, h_out is that, or what came in."""
    rng = np.random.default_rng(seed)
    weights = [numpy_helper.from_array(rng.normal(0, 0.3, (inputs, outputs)).astype("f4"), "w")]
    of, node = helper.make_tensor_value_info, helper.make_node
    takes, gives = [of("x", kind, [1, inputs])], [of("y", TensorProto.FLOAT, [1, outputs])]
    nodes = [node("Cast", ["x"], ["f"], to=TensorProto.FLOAT), node("MatMul", ["f", "w"], ["z"])]
    if memory:
        takes.append(of("h_in", TensorProto.FLOAT, [1, outputs]))
        gives.append(of("h_out", TensorProto.FLOAT, [1, outputs]))
        nodes.append(node("Add", ["z", "h_in"], ["s"]))
        nodes.append(node("Tanh", ["s"], ["y"]))
        nodes.append(node("Identity", ["h_in" if memory == "itself" else "y"], ["h_out"]))
    else:
        nodes.append(node("Tanh", ["z"], ["y"]))
    made = helper.make_graph(nodes, "g", takes, gives, weights)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return model.SerializeToString()


@pytest.fixture
def opened(tmp_path):
    """A function that writes and opens a policy of three graphs."""

    def opened(*, memory=None, of_body=None, rate="", late="", given="late", takes="early, pose"):
        files = {
            "early": graph(12, 5, seed=1, memory=memory),
            "late": graph(17 if "pose" in takes else 5, 7, seed=2),
            "body": graph(24, 12, seed=3, memory=of_body),
        }
        for name, data in files.items():
            (tmp_path / f"{name}.onnx").write_bytes(data)
        (tmp_path / "policy.yaml").write_text(
            CARD.format(rate=rate, late=late, given=given, takes=takes)
        )
        policy = open_policy(load_bundle(tmp_path))
        policy.reset(0)
        return policy

    return opened


def shown(count):
    rng = np.random.default_rng(5)
    speeds = rng.normal(size=(count, 12)).astype(np.float32)
    return [
        {"pose": rng.normal(size=12).astype(np.float32), "speeds": speeds[step // 3 * 3]}
        for step in range(count)
    ]


CASES = {
    "functions": {},
    "a slow one before": {"rate": ", rate: 10"},
    "a slow one behind": {"late": ", rate: 10"},
    "a slow one behind alone": {"late": ", rate: 10", "takes": "early"},
    "one that remembers": {"memory": "sum"},
    "a policy that remembers": {"of_body": "sum", "rate": ", rate: 25"},
    "all": {"memory": "sum", "of_body": "sum", "rate": ", rate: 25", "late": ", rate: 10"},
}


def one_by_one(monkeypatch):
    monkeypatch.setattr(FedPolicy, "_planned", lambda *_: None)


@pytest.mark.parametrize("case", CASES)
def test_a_plan_has_the_bits_of_networks_that_are_asked_one_by_one(opened, monkeypatch, case):
    def told(policy):
        return [(policy.act(one).tobytes(), policy.state(), str(policy.held)) for one in shown(13)]

    plan = opened(**CASES[case])
    planned = told(plan)
    assert isinstance(plan._plan, OnePlan)
    plan.reset(1)
    assert told(plan) == planned
    one_by_one(monkeypatch)
    apart = opened(**CASES[case])
    assert told(apart) == planned
    assert apart._plan is None


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("has_acted", [False, True])
def test_a_state_goes_on_in_a_plan_wherever_it_was_taken(opened, monkeypatch, case, has_acted):
    observations = shown(16)
    policy = opened(**CASES[case])
    for one in observations[:7]:
        policy.act(one)
    state = policy.state()
    rest = [policy.act(one).tobytes() for one in observations[7:]]
    for _ in range(2):  # In a plan, then one by one.
        other = opened(**CASES[case])
        if has_acted:
            other.act(observations[9])  # What a slow network takes at action 10, too.
        other.restore(state)
        assert other.state() == state
        assert [other.act(one).tobytes() for one in observations[7:]] == rest
        one_by_one(monkeypatch)


@pytest.mark.parametrize(
    "case",
    [
        {"memory": "itself"},
        {"late": ", outputs: {twice: {scale: 2.0}}", "given": "late.twice"},
        {"late": ", outputs: {some: {select: ['0:7']}}", "given": "late.some"},
    ],
)
def test_what_a_plan_cannot_say_runs_one_by_one(opened, case):
    policy = opened(**case)
    policy.act(shown(1)[0])
    assert policy._plan is None


def test_an_observation_of_another_type_is_taken_as_before(opened, monkeypatch):
    def told(policy):
        wide = [{k: v.astype(np.float64) for k, v in one.items()} for one in shown(6)]
        return [policy.act(one).tobytes() for one in [*shown(6), *wide]]

    case = CASES["all"]
    planned = told(opened(**case))
    one_by_one(monkeypatch)
    assert told(opened(**case)) == planned


def test_an_observation_of_another_size_is_refused_with_its_network(opened):
    policy = opened()
    policy.act(shown(1)[0])
    with pytest.raises(TrialError, match=r"network `early` .*\(1, 11\), not \(1, 12\)"):
        policy.act({"pose": np.zeros(12, np.float32), "speeds": np.zeros(11, np.float32)})


def test_what_is_no_number_is_said_again_at_the_next_action(opened):
    policy = opened()
    one = shown(1)[0]
    policy.act(one)
    for _ in range(2):
        with pytest.raises(TrialError, match="network `early` of policy 'fed' gave nan for number"):
            policy.act(one | {"speeds": np.full(12, np.nan, np.float32)})


def test_a_closed_plan_says_so(opened):
    policy = opened()
    policy.act(shown(1)[0])
    policy.close()
    with pytest.raises(TrialError, match="network `early` of policy 'fed' is closed"):
        policy.act(shown(1)[0])
