"""Policies that other networks feed: the numbers of one network, each file at its own rate."""

import hashlib
import io
import re

import numpy as np
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from nw_base.errors import PolicyError, TrialError
from nw_base.memory import pack
from nw_policies import load_bundle, open_policy
from nw_policies.one_plan import OnePlan
from nw_policies.serve import serving
from nw_sim.rollout.confined.vetting import check_bundle

# torch recommends torch.export for new files; people have these.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

OBSERVATIONS = {
    "pose": "{sensor: proprio, terms: [joint_pos]}",
    "past": "{sensor: proprio, terms: [joint_pos, foot_contacts], history: 5}",
}
ADAPTERS = {"onnx": "onnx", "pt": "torchscript", "pt2": "torch-export"}


def bundle_of(folder, files, *, inputs, own="body", rate=50, **networks):
    """A bundle of files by name; networks say the name of their file, then the rest of them."""
    folder.mkdir(exist_ok=True)
    named = {}
    for name, data in files.items():
        (folder / name).write_bytes(data)
        digest = hashlib.sha256(data).hexdigest()
        kind = ADAPTERS[name.rpartition(".")[2]]
        stem = name.partition(".")[0]
        named[stem] = f"adapter: {kind}, checkpoint: {{file: {name}, sha256: {digest}}}"
    lines = [
        "nw-policy: 1",
        "name: fed",
        "robot: go1",
        *named[own].split(", ", 1),
        f"control: {{action: joint_position_offset, scale: 0.25, rate: {rate}}}",
        "networks:",
        *(
            f"  {name}: {{{named[rest.partition(',')[0]]},{rest.partition(',')[2]}}}"
            for name, rest in networks.items()
        ),
        f"inputs: {inputs}",
        "observations:",
    ]
    lines += [f"  {name}: {sees}" for name, sees in OBSERVATIONS.items() if name in str(lines)]
    if not networks:
        lines.remove("networks:")
    (folder / "policy.yaml").write_text("\n".join(lines) + "\n")
    return load_bundle(folder)


def scripted(module):
    buffer = io.BytesIO()
    torch.jit.save(torch.jit.script(module.eval()), buffer)
    return buffer.getvalue()


def exported(module, *example):
    buffer = io.BytesIO()
    torch.export.save(torch.export.export(module.eval(), example), buffer)
    return buffer.getvalue()


def linear(weight):
    """An ONNX graph `out` = `obs` @ weight.T, whose second output `twice` is 2 * `out`."""
    outputs, inputs = weight.shape
    graph = helper.make_graph(
        [
            helper.make_node("Gemm", ["obs", "weight"], ["out"], transB=1),
            helper.make_node("Add", ["out", "out"], ["twice"]),
        ],
        "linear",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, inputs])],
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, outputs])
            for name in ("out", "twice")
        ],
        [numpy_helper.from_array(weight.astype(np.float32), "weight")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    return model.SerializeToString()


def seen(count, seed=0):
    rng = np.random.default_rng(seed)
    sizes = {"pose": 12, "past": 80}
    return [
        {name: rng.normal(size=size).astype(np.float32) for name, size in sizes.items()}
        for _ in range(count)
    ]


def walk(policy, observations):
    policy.reset(0)
    return [policy.act(observation).tolist() for observation in observations]


class Adaptation(nn.Module):
    def __init__(self):
        super().__init__()
        self.net = nn.Sequential(nn.Linear(80, 32), nn.ELU(), nn.Linear(32, 18))

    def forward(self, past: torch.Tensor) -> torch.Tensor:
        return self.net(past)


class Body(nn.Module):
    def __init__(self):
        super().__init__()
        self.net = nn.Sequential(nn.Linear(80 + 18, 64), nn.ELU(), nn.Linear(64, 12))

    def forward(self, both: torch.Tensor) -> torch.Tensor:
        return self.net(both)


class Whole(nn.Module):
    def __init__(self, adaptation, body):
        super().__init__()
        self.adaptation, self.body = adaptation, body

    def forward(self, past: torch.Tensor) -> torch.Tensor:
        return self.body(torch.cat([past, self.adaptation(past)], dim=-1))


def drawn(module):
    with torch.random.fork_rng(), torch.no_grad():
        torch.manual_seed(1)
        for parameter in module.parameters():
            parameter.copy_(torch.randn(parameter.shape) * 0.2)
    return module


@pytest.mark.parametrize("kinds", [("pt", "pt"), ("pt2", "pt2"), ("pt2", "pt")])
def test_two_files_give_the_actions_of_one_bit_for_bit(tmp_path, kinds):
    adaptation, body = drawn(Adaptation()), drawn(Body())
    saved = {
        "pt": (scripted(adaptation), scripted(body)),
        "pt2": (exported(adaptation, torch.zeros(1, 80)), exported(body, torch.zeros(1, 98))),
    }
    files = {f"front.{kinds[0]}": saved[kinds[0]][0], f"body.{kinds[1]}": saved[kinds[1]][1]}
    split = bundle_of(
        tmp_path / "split",
        files,
        inputs="[past, adaptation]",
        adaptation="front, inputs: [past]",
    )
    whole = bundle_of(
        tmp_path / "whole", {"body.pt": scripted(Whole(adaptation, body))}, inputs="[past]"
    )
    check_bundle(split)
    actions = walk(open_policy(split), seen(8))
    assert actions == walk(open_policy(whole), seen(8))
    assert actions[0] != actions[1]


PICK = np.eye(12, 20)  # The first twelve of twenty numbers.


class Encoder(nn.Module):
    """As DreamWaQ's: an estimate of the velocity, and the mean of a latent."""

    def forward(self, past: torch.Tensor):
        return past[:, 40:43], past[:, 0:16] + 1.0


def test_outputs_have_names_slices_and_scales(tmp_path):
    files = {"encoder.pt": scripted(Encoder()), "body.onnx": linear(np.eye(12, 12))}
    bundle = bundle_of(
        tmp_path,
        files,
        inputs="{obs: [encoder.velocity, encoder.mean, encoder.last]}",
        encoder="encoder, inputs: [past], outputs: {velocity: {scale: [2, 2, 4]}, "
        'mean: {output: 1, select: ["2:10"]}, last: {output: 1, select: [15], scale: -1}}',
    )
    check_bundle(bundle)
    policy = open_policy(bundle)
    policy.reset(0)
    past = np.arange(80, dtype=np.float32)
    action = policy.act({"past": past})
    expected = [80.0, 82.0, 168.0, *(past[2:10] + 1.0), -16.0]
    assert action.tolist() == expected


def test_an_output_of_a_graph_is_named_or_counted(tmp_path):
    files = {"front.onnx": linear(PICK[:, :12]), "body.onnx": linear(np.eye(12, 24))}
    for wanted in ("twice", 1):
        bundle = bundle_of(
            tmp_path,
            files,
            inputs="[front.doubled, pose]",
            front=f"front, inputs: [pose], outputs: {{doubled: {{output: {wanted}}}}}",
        )
        assert walk(open_policy(bundle), [{"pose": np.ones(12, np.float32)}]) == [[2.0] * 12]


def test_a_chain_of_three_formats_runs_in_its_own_order_whatever_the_cards(tmp_path):
    class Doubling(nn.Module):
        def forward(self, x):
            return 2.0 * x

    files = {
        "body.onnx": linear(np.eye(12, 24)),
        "plus.pt": scripted(PlusOne()),
        "times.pt2": exported(Doubling(), torch.zeros(1, 12)),
    }
    bundle = bundle_of(
        tmp_path,
        files,
        inputs="[later, pose]",
        later="plus, inputs: {whatever: [earlier]}",
        earlier="times, inputs: {x: [pose]}",
    )
    check_bundle(bundle)
    assert walk(open_policy(bundle), [{"pose": np.full(12, 5, np.float32)}]) == [[11.0] * 12]


class PlusOne(nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x + 1.0


class Counting(nn.Module):
    """Counts how often it was asked, in a buffer, as rsl_rl keeps recurrent state."""

    def __init__(self):
        super().__init__()
        self.register_buffer("count", torch.zeros(1, 12))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.count += 1.0
        return self.count + 0.0 * x


def counting(folder, rate=10, control=50):
    files = {"encoder.pt": scripted(Counting()), "body.pt": scripted(PlusOne())}
    return bundle_of(
        folder,
        files,
        inputs="[encoder]",
        rate=control,
        encoder=f"encoder, inputs: [pose], rate: {rate}",
    )


POSE = {"pose": np.zeros(12, np.float32)}


@pytest.mark.parametrize(("rate", "control", "every"), [(10, 50, 5), (50, 50, 1), (5, 25, 5)])
def test_a_network_is_asked_at_its_own_rate_and_held_in_between(tmp_path, rate, control, every):
    policy = open_policy(counting(tmp_path, rate, control))
    asked = [int(action[0]) - 1 for action in walk(policy, [POSE] * 12)]
    assert asked == [1 + step // every for step in range(12)]


def doubling(name="seen", count=12):
    """A graph that doubles its one input, as bytes."""
    shape = [1, count]
    graph = helper.make_graph(
        [helper.make_node("Add", [name, name], ["out"])],
        "doubling",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, shape)],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return model.SerializeToString()


@pytest.mark.parametrize("is_writeable", [True, False])
def test_a_graph_without_memory_runs_when_it_is_given_something_else(
    tmp_path, monkeypatch, is_writeable
):
    files = {"encoder.onnx": doubling(), "body.onnx": doubling()}
    bundle = bundle_of(tmp_path, files, inputs="[encoder]", encoder="encoder, inputs: [pose]")
    policy = open_policy(bundle)
    asked, run = [], OnePlan._run
    monkeypatch.setattr(
        OnePlan, "_run", lambda plan, which: asked.append(0 in which) or run(plan, which)
    )
    pose = np.zeros(12, np.float32)
    shown = pose.view()  # Behind the fence, of memory that the trial writes into.
    shown.flags.writeable = is_writeable
    actions = []
    for step in range(6):
        pose[:] = step // 3  # In the same memory, as a sensor may do it.
        actions.append(policy.act({"pose": shown})[0])
    assert (sum(asked), actions) == (2, [0.0] * 3 + [4.0] * 3)
    policy.reset(1)
    assert policy.act({"pose": shown})[0] == 4.0


def test_what_networks_remember_is_reset_saved_and_restored(tmp_path):
    policy = open_policy(counting(tmp_path))
    first = walk(policy, [POSE] * 12)
    assert walk(policy, [POSE] * 12) == first
    walk(policy, [POSE] * 3)
    saved = policy.state()
    rest = [policy.act(POSE).tolist() for _ in range(9)]
    assert rest == first[3:]
    another = open_policy(counting(tmp_path))
    another.reset(0)
    another.restore(saved)
    assert another.state() == saved
    assert [another.act(POSE).tolist() for _ in range(9)] == rest


def test_a_state_of_another_policy_does_not_fit(tmp_path):
    policy = open_policy(counting(tmp_path / "one"))
    walk(policy, [POSE])
    for state in (pack({"hidden": np.ones(3)}), b"nonsense"):
        with pytest.raises(TrialError, match="does not fit policy 'fed'"):
            policy.restore(state)


def test_values_that_are_not_numbers_are_attributed_to_the_network(tmp_path):
    class Dividing(nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return 1.0 / x

    files = {"encoder.pt": scripted(Dividing()), "body.onnx": linear(np.eye(12))}
    bundle = bundle_of(tmp_path, files, inputs="[encoder]", encoder="encoder, inputs: [pose]")
    policy = open_policy(bundle)
    pose = np.ones(12, np.float32)
    pose[3] = 0.0
    policy.reset(0)
    expected = "network `encoder` of policy 'fed' gave inf for number 3 of `encoder`"
    with pytest.raises(TrialError, match=expected):
        policy.act({"pose": pose})


def test_a_closed_network_says_so(tmp_path):
    policy = open_policy(counting(tmp_path))
    policy.reset(0)
    policy.close()
    policy.close()
    with pytest.raises(TrialError, match="network `encoder` of policy 'fed' is closed"):
        policy.act(POSE)


PAST = "the card makes `past` 80 = 5 x (12 + 4)"
ZEROS = "networks.encoder: on an observation of zeros, "
CHECKED = {
    "a declared size": (
        lambda: linear(PICK),
        "",
        f"networks.encoder: `past` is 80 numbers; the checkpoint's input `obs` wants 20; {PAST}",
    ),
    "a size that no file declares": (
        lambda: scripted(nn.Linear(45, 12)),
        "",
        f"networks.encoder: `past` is 80 numbers; the checkpoint's first layer wants 45; {PAST}",
    ),
    "what the policy gets": (
        lambda: linear(np.eye(16, 80)),
        "",
        "policy.yaml: `encoder` is 16 numbers; the checkpoint's input `obs` wants 12; the card",
    ),
    "a slice beyond the output": (
        lambda: linear(np.eye(16, 80)),
        'select: ["8:20"]',
        f"{ZEROS}`encoder.a`: select: '8:20' is outside the 16 numbers of the output",
    ),
    "no slice": (
        lambda: linear(np.eye(16, 80)),
        "select: [all]",
        f"{ZEROS}`encoder.a`: select: 'all' is not an index or range; write 7 or 13:53",
    ),
    "scales of another number": (
        lambda: linear(np.eye(12, 80)),
        "scale: [1, 2]",
        f"{ZEROS}`encoder.a`: `scale` has 2 numbers, the output 12",
    ),
    "an output that is not there": (
        lambda: linear(np.eye(12, 80)),
        "output: twcie",
        "networks.encoder: the checkpoint has no output 'twcie'; did you mean 'twice'?",
    ),
    "an output that a script cannot name": (
        lambda: scripted(PlusOne()),
        "output: latent",
        "networks.encoder: output 'latent': the outputs of a TorchScript file have no names; give",
    ),
    "a place beyond the outputs": (
        lambda: scripted(PlusOne()),
        "output: 1",
        "network `encoder` of policy 'fed' returned 1 tensor, none at index 1",
    ),
}


@pytest.mark.parametrize("case", CHECKED)
def test_what_does_not_fit_is_reported_in_the_cards_terms(tmp_path, case):
    make, output, said = CHECKED[case]
    data = make()
    files = {f"encoder.{'pt' if data[:2] == b'PK' else 'onnx'}": data}
    files["body.onnx"] = linear(np.eye(12))
    named = f", outputs: {{a: {{{output}}}}}" if output else ""
    bundle = bundle_of(
        tmp_path,
        files,
        inputs="[encoder.a]" if output else "[encoder]",
        encoder=f"encoder, inputs: [past]{named}",
    )
    with pytest.raises(PolicyError) as caught:
        check_bundle(bundle)
    assert said in str(caught.value)


def test_an_input_that_is_not_there_is_reported_with_the_network(tmp_path):
    files = {"encoder.onnx": linear(np.eye(12, 80)), "body.onnx": linear(np.eye(12))}
    bundle = bundle_of(
        tmp_path, files, inputs="[encoder]", encoder="encoder, inputs: {ops: [past]}"
    )
    expected = r"networks\.encoder: the checkpoint has no input 'ops'; did you mean 'obs'\?"
    with pytest.raises(PolicyError, match=expected):
        check_bundle(bundle)


def test_the_action_of_a_script_is_chosen_by_its_place(tmp_path):
    class Two(nn.Module):
        def forward(self, x: torch.Tensor):
            return x[:, :3], x + 1.0

    bundle = bundle_of(tmp_path, {"body.pt": scripted(Two())}, inputs="[pose]")
    with (tmp_path / "policy.yaml").open("a") as card:
        card.write("output: 1\n")
    assert walk(open_policy(load_bundle(bundle.card_path)), [POSE]) == [[1.0] * 12]


def test_a_fed_policy_is_served_whole(tmp_path):
    bundle = counting(tmp_path / "here")
    (tmp_path / "there").mkdir()
    with serving(bundle) as address:
        (tmp_path / "there/policy.yaml").write_text(
            "nw-policy: 1\nname: away\nrobot: go1\nadapter: remote\n"
            f"options: {{url: {address.url}}}\n"
            "control: {action: joint_position_offset, scale: 0.25}\n"
            f"observations:\n  pose: {OBSERVATIONS['pose']}\n"
        )
        policy = open_policy(load_bundle(tmp_path / "there"))
        away = walk(policy, [POSE] * 7)
        policy.close()
    assert away == walk(open_policy(bundle), [POSE] * 7)


def test_a_policy_in_python_is_given_outputs_by_name(tmp_path):
    bundle_of(
        tmp_path,
        {"encoder.onnx": linear(np.eye(12)), "body.pt": scripted(PlusOne())},
        inputs="[encoder.doubled]",
        encoder="encoder, inputs: [pose], outputs: {doubled: {output: twice}}",
    )
    text = (tmp_path / "policy.yaml").read_text()
    text = re.sub(r"adapter: torchscript\ncheckpoint: .*", "adapter: python:only_code:Mine", text)
    (tmp_path / "policy.yaml").write_text(text.replace("inputs: [encoder.doubled]\n", ""))
    (tmp_path / "only_code.py").write_text(
        "class Mine:\n"
        "    def __init__(self, bundle): pass\n"
        "    def act(self, observation):\n"
        "        return observation['encoder.doubled'] + observation['pose']\n"
    )
    bundle = load_bundle(tmp_path)
    check_bundle(bundle, allow_code=True)
    policy = open_policy(bundle, allow_code=True)
    assert walk(policy, [{"pose": np.ones(12, np.float32)}]) == [[3.0] * 12]
