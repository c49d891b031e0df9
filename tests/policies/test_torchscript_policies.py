import dataclasses
import hashlib
import io
import os
import re
import zipfile

import numpy as np
import pytest
import torch
from adapters import by_its_own_runtime

from nw_base.confinement import offered
from nw_base.errors import PolicyError, TrialError
from nw_policies import load_bundle, open_policy
from nw_policies.drafting.checkpoint import inspect_checkpoint
from nw_policies.drafting.draft import write_card_draft
from nw_policies.line import line_to, trusting
from nw_scenes.robots import get_robot
from nw_sim.rollout.confined.access import policy_rules
from nw_sim.rollout.confined.start import PolicyProcess
from nw_sim.rollout.confined.vetting import check_bundle

CARD = """\
nw-policy: 1
name: mine
robot: go1
adapter: torchscript
checkpoint: {file: policy.pt, sha256: %s}
control: {action: joint_position_offset, scale: 0.25}
observations: {body: {sensor: proprio, terms: [joint_pos]}}
"""


def untrusted():
    return trusting(all_=False)


def bundle_of(folder, data, more=""):
    (folder / "policy.pt").write_bytes(data)
    (folder / "policy.yaml").write_text(CARD % hashlib.sha256(data).hexdigest() + more)
    return load_bundle(folder)


# torch recommends torch.export for new files; people have these.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def scripted(module):
    buffer = io.BytesIO()
    torch.jit.save(torch.jit.script(module), buffer)
    return buffer.getvalue()


def test_a_size_that_the_file_does_not_declare_is_still_said_in_the_cards_terms(tmp_path):
    bundle = bundle_of(tmp_path, scripted(torch.nn.Linear(45, 12)))
    expected = r"`body` is 12 numbers; the checkpoint's first layer wants 45; .*`body` 12"
    with pytest.raises(PolicyError, match=expected):
        check_bundle(bundle)


class Doubling(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return 2.0 * x


@pytest.mark.parametrize("runtime", ["nw-eval", "native"])
def test_a_policy_s_process_need_not_read_the_files_of_its_robot(tmp_path, runtime):
    """It may not: of a robot in a folder the trial's process alone reads them."""
    more = "runtime: native\n" if runtime == "native" else ""
    bundle = bundle_of(tmp_path, scripted(Doubling()), more)
    assert bundle.joints == 12
    card = bundle.card.model_copy(update={"robot": "in-a-folder"})
    elsewhere = dataclasses.replace(bundle, card=card)
    elsewhere.__dict__["joints"] = bundle.joints  # As a pickle brings them.
    with PolicyProcess(policy_rules(bundle)) as process, line_to(process.line):
        policy = open_policy(elsewhere)
        policy.reset(0)
        answer = policy.act({"body": np.ones(12, np.float32)})
        policy.close()
    np.testing.assert_array_equal(answer, np.full(12, 2.0))


def test_another_robot_s_joints_are_not_those_of_the_card_before():
    bundle = load_bundle("go1-parkour")
    assert bundle.joints == 12
    assert bundle.by_its_own_runtime("Foo").__dict__["joints"] == 12
    card = bundle.card.model_copy(update={"robot": "other"})
    assert "joints" not in bundle.with_changes(card=card).__dict__


class Executes:
    """A pickle of this object makes a file when it is loaded carelessly."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return (os.mkdir, (self.mark,))


class Writing(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        torch.save(x, "written.pt")
        return x


class Reading(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.from_file("secret", False, x.numel(), dtype=torch.uint8).float()


@pytest.mark.parametrize("module", [Writing(), Reading()], ids=["writes", "reads"])
def test_a_script_is_not_opened_where_nothing_holds_it(tmp_path, module):
    with (
        untrusted(),
        pytest.raises(PolicyError, match=r"the system offers no fence .* --allow-code"),
    ):
        open_policy(bundle_of(tmp_path, scripted(module)))


@pytest.mark.skipif(not (offered().landlock and offered().seccomp), reason="there is no fence")
def test_an_evil_script_reads_and_writes_nothing_behind_the_wall(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "secret").write_bytes(b"s" * 64)
    came = {}
    for module in (Writing(), Reading()):
        folder = tmp_path / type(module).__name__
        folder.mkdir()
        bundle = bundle_of(folder, scripted(module))
        with PolicyProcess(policy_rules(bundle)) as process, line_to(process.line):
            policy = open_policy(bundle)
            policy.reset(0)
            try:
                came[folder.name] = policy.act({"body": np.zeros(12, dtype=np.float32)}).tolist()
            except TrialError as error:
                came[folder.name] = str(error)
    assert "Permission denied" in came["Reading"]
    assert ord("s") not in came["Writing"]
    assert not list(tmp_path.rglob("written.pt"))
    with trusting():  # What it would have done.
        bundle = by_its_own_runtime(bundle_of(tmp_path / "Writing", scripted(Writing())))
        open_policy(bundle).act({"body": np.zeros(12, dtype=np.float32)})
    assert list(tmp_path.rglob("written.pt")) == [tmp_path / "written.pt"]


class Noisy(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x + torch.randn_like(x)


def test_a_script_that_draws_noise_draws_it_from_the_trials_seed(tmp_path):
    bundle = bundle_of(tmp_path, scripted(Noisy()))
    body = {"body": np.zeros(12, dtype=np.float32)}

    def drawn(policy, seed):
        policy.reset(seed)
        first = [policy.act(body).tolist() for _ in range(3)]
        state = policy.state()
        rest = [policy.act(body).tolist() for _ in range(3)]
        policy.restore(state)
        assert [policy.act(body).tolist() for _ in range(3)] == rest, "it goes on as it did"
        policy.close()
        return first + rest

    before = torch.get_rng_state()
    here = drawn(open_policy(bundle), 7)
    assert torch.equal(torch.get_rng_state(), before), "the caller's generator is its own"
    assert here == drawn(open_policy(bundle), 7) != drawn(open_policy(bundle), 8)
    with PolicyProcess(policy_rules(bundle)) as process, line_to(process.line):
        assert drawn(open_policy(bundle), 7) == here
        assert drawn(open_policy(bundle), 7) == here


def test_a_scripted_module_acts(tmp_path):
    policy = open_policy(bundle_of(tmp_path, scripted(Doubling())))
    action = policy.act({"body": np.arange(12, dtype=np.float32)})
    assert action.tolist() == [2.0 * k for k in range(12)]


def test_a_module_that_wants_another_size_is_a_trial_error(tmp_path):
    policy = open_policy(bundle_of(tmp_path, scripted(torch.nn.Linear(45, 12))))
    with pytest.raises(TrialError, match=r"policy 'mine' failed: .*1x12 and 45x12"):
        policy.act({"body": np.zeros(12, dtype=np.float32)})


def test_a_pickle_is_refused_and_not_run(tmp_path):
    mark = tmp_path / "executed"
    torch.save(Executes(str(mark)), tmp_path / "evil.pt")
    with pytest.raises(PolicyError, match="not a TorchScript file"):
        open_policy(bundle_of(tmp_path, (tmp_path / "evil.pt").read_bytes()))
    assert not mark.exists()


def test_a_pickle_that_poses_as_torchscript_is_not_run(tmp_path):
    mark = tmp_path / "executed"
    torch.save(Executes(str(mark)), tmp_path / "evil.pt")
    source = zipfile.ZipFile(tmp_path / "evil.pt")
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for member in source.infolist():
            archive.writestr(member, source.read(member))
        root = source.infolist()[0].filename.split("/")[0]
        archive.writestr(f"{root}/constants.pkl", source.read(f"{root}/data.pkl"))
    with pytest.raises(PolicyError, match=r"asks to call 'posix\.mkdir'"):
        open_policy(bundle_of(tmp_path, buffer.getvalue()))
    assert not mark.exists()


def test_a_state_dict_is_answered_with_how_to_save(tmp_path):
    torch.save({"weight": torch.zeros(3)}, tmp_path / "state.pt")
    with pytest.raises(PolicyError, match=r"state dict.*torch\.jit\.save"):
        open_policy(bundle_of(tmp_path, (tmp_path / "state.pt").read_bytes()))


def test_an_archive_that_unpacks_to_too_much_is_refused_before_unpacking(tmp_path):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("m/constants.pkl", bytes(5_000_000))
        archive.writestr("m/data.pkl", b"\x80\x02}.")
    assert len(buffer.getvalue()) < 10_000
    with pytest.raises(PolicyError, match="compressed 1025 times, like a zip bomb"):
        open_policy(bundle_of(tmp_path, buffer.getvalue()))


def test_an_archive_with_members_outside_is_refused(tmp_path):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("m/constants.pkl", b"x")
        archive.writestr("m/data.pkl", b"x")
        archive.writestr("../../evil", b"x")
    with pytest.raises(PolicyError, match=r"member '\.\./\.\./evil' points outside"):
        open_policy(bundle_of(tmp_path, buffer.getvalue()))


def test_bytes_that_are_no_archive_are_refused(tmp_path):
    with pytest.raises(PolicyError, match="not a TorchScript file: its format is unknown"):
        open_policy(bundle_of(tmp_path, b"nothing"))


class Counting(torch.nn.Module):
    """Remembers in a buffer, in a plain tensor, in a number, and in a part of its own."""

    def __init__(self):
        super().__init__()
        self.register_buffer("hidden", torch.zeros(1, 12))
        self.plain = torch.zeros(12)
        self.steps = 0
        self.part = Adding()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.hidden = self.hidden + x
        self.plain = self.plain + 1.0
        self.steps += 1
        return self.hidden + 10.0 * self.plain + 100.0 * self.steps + self.part(x)


class Adding(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.register_buffer("total", torch.zeros(1, 12))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.total += 1000.0 * x
        return self.total


class Collecting(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.seen = [torch.zeros(1)]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.seen = [x]
        return x


def test_an_object_without_an_attribute_of_its_class_is_refused(tmp_path):
    source, damaged = zipfile.ZipFile(io.BytesIO(scripted(Doubling()))), io.BytesIO()
    with zipfile.ZipFile(damaged, "w") as target:
        for name in source.namelist():
            # Torch meets this with an IndexError.
            target.writestr(name, source.read(name).replace(b"\x08\0\0\0training", b"\x01\0\0\0t"))
    with pytest.raises(PolicyError, match="not a usable TorchScript file"):
        open_policy(bundle_of(tmp_path, damaged.getvalue()))


def test_a_recurrent_script_is_reset_saved_and_restored(tmp_path):
    policy = open_policy(bundle_of(tmp_path, scripted(Counting())))
    observation = {"body": np.ones(12, np.float32)}
    fresh = policy.state()
    first, second = policy.act(observation), policy.act(observation)
    assert first[0] == 1 + 10 + 100 + 1000
    assert second[0] == 2 * first[0]
    saved = policy.state()
    third = policy.act(observation)
    policy.restore(saved)
    np.testing.assert_array_equal(policy.act(observation), third)
    policy.reset(0)
    assert policy.state() == fresh == b""
    np.testing.assert_array_equal(policy.act(observation), first)


def test_a_script_whose_memory_cannot_be_saved_is_refused(tmp_path):
    with pytest.raises(PolicyError, match="its code changes `seen`, a list"):
        open_policy(bundle_of(tmp_path, scripted(Collecting())))


def test_the_state_of_another_script_does_not_fit(tmp_path):
    policy = open_policy(by_its_own_runtime(bundle_of(tmp_path, scripted(Counting()))))
    policy.act({"body": np.ones(12, np.float32)})
    saved = policy.state()
    other = open_policy(by_its_own_runtime(bundle_of(tmp_path, scripted(Doubling()))))
    with pytest.raises(TrialError, match="does not fit policy 'mine'"):
        other.restore(saved)


class FedBack(torch.nn.Module):
    """What LEAPP exports of a policy that sees its last action: state goes in and comes out."""

    def forward(self, h: torch.Tensor, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        h += 1.0  # What it is given is a copy.
        return h * 2.0, x + h


FEEDS = "inputs: {x: [body]}\nrecurrent: {h: {output: 0, shape: [1, 12]}}\n"


def test_an_output_that_feeds_an_input_is_reset_saved_and_restored(tmp_path):
    policy = open_policy(by_its_own_runtime(bundle_of(tmp_path, scripted(FedBack()), FEEDS)))
    observation = {"body": np.zeros(12, np.float32)}
    assert [policy.act(observation)[0] for _ in range(3)] == [1, 3, 7]
    saved = policy.state()
    assert policy.act(observation)[0] == 15
    policy.restore(saved)
    assert policy.act(observation)[0] == 15
    policy.reset(0)
    assert policy.state() == b""
    assert policy.act(observation)[0] == 1


@pytest.mark.parametrize(
    ("was", "becomes", "said"),
    [
        ("{h:", "{g:", "takes no 'g', which `recurrent` names"),
        ("[1, 12]", "[1, 11]", "correct `recurrent`|size of tensor"),
        ("output: 0", "output: 5", "none at index 5"),
    ],
)
def test_what_is_fed_back_otherwise_than_the_card_says_is_named(tmp_path, was, becomes, said):
    bundle = bundle_of(tmp_path, scripted(FedBack()), FEEDS.replace(was, becomes))
    with pytest.raises((PolicyError, TrialError), match=said):
        open_policy(bundle).act({"body": np.zeros(12, np.float32)})


class Cnn(torch.nn.Sequential):
    """rsl_rl's `modules/cnn.py`: layers by number, flattened at the end."""

    def __init__(self, channels):
        layers = (torch.nn.Conv2d(channels, 4, 3, stride=2), torch.nn.ELU(), torch.nn.Flatten(1))
        super().__init__(*layers)


class Normalization(torch.nn.Module):
    """rsl_rl's `EmpiricalNormalization`."""

    def __init__(self, size):
        super().__init__()
        self.register_buffer("_mean", torch.randn(1, size))
        self.register_buffer("_std", torch.rand(1, size))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return (x - self._mean) / (self._std + 0.01)


class WithPictures(torch.nn.Module):
    """The JIT export of rsl_rl's `models/cnn_model.py` (5.4.1), `_TorchCNNModel`."""

    def __init__(self):
        super().__init__()
        self.obs_normalizer = Normalization(12)
        self.cnns = torch.nn.ModuleList([Cnn(1), Cnn(1)])
        self.mlp = torch.nn.Sequential(torch.nn.Linear(12 + 2 * 4 * 4 * 7, 8), torch.nn.ELU())
        self.mlp.append(torch.nn.Linear(8, 12))
        self.deterministic_output = torch.nn.Identity()

    def forward(self, obs_1d: torch.Tensor, obs_2d: list[torch.Tensor]) -> torch.Tensor:
        latent_1d = self.obs_normalizer(obs_1d)
        latent_cnn_list = []
        for i, cnn in enumerate(self.cnns):
            latent_cnn_list.append(cnn(obs_2d[i]))
        latent_cnn = torch.cat(latent_cnn_list, dim=-1)
        latent = torch.cat([latent_1d, latent_cnn], dim=-1)
        out = self.mlp(latent)
        return self.deterministic_output(out)

    @torch.jit.export
    def reset(self) -> None:
        pass


PICTURES = """\
nw-policy: 1
name: pictures
robot: go1
adapter: torchscript
checkpoint: {file: policy.pt}
control: {action: joint_position_offset, scale: 0.25}
inputs: INPUTS
observations:
  body: {sensor: proprio, terms: [joint_pos]}
  front: {sensor: depth, width: 16, height: 9, wrap: [channels]}
  rear: {sensor: depth, width: 16, height: 9, wrap: [channels]}
"""


@pytest.fixture
def pictures(tmp_path):
    with torch.random.fork_rng():
        torch.manual_seed(1)
        module = WithPictures().eval()
    (tmp_path / "policy.pt").write_bytes(scripted(module))

    def card(inputs):
        (tmp_path / "policy.yaml").write_text(PICTURES.replace("INPUTS", inputs))
        return load_bundle(tmp_path)

    return module, card


def test_an_input_that_is_a_list_of_pictures_is_fed_in_the_order_of_the_card(pictures):
    module, card = pictures
    rng = np.random.default_rng(0)
    sizes = {"body": (12,), "front": (1, 9, 16), "rear": (1, 9, 16)}
    seen = {name: rng.normal(size=size).astype(np.float32) for name, size in sizes.items()}
    body, front, rear = (torch.from_numpy(array)[None] for array in seen.values())
    for inputs, images in (("front, rear", [front, rear]), ("rear, front", [rear, front])):
        bundle = card(f"{{obs_1d: [body], obs_2d: {{list: [{inputs}]}}}}")
        check_bundle(bundle)
        policy = open_policy(bundle)
        policy.reset(0)
        wanted = module(body, images).detach().numpy()[0]
        np.testing.assert_allclose(policy.act(seen), wanted, atol=1e-6)


@pytest.mark.parametrize(
    ("inputs", "said"),
    [
        ("{obs_1d: [body], obs_2d: [front, rear]}", "obs_2d: {list: [front, rear]}}`"),
        ("{obs_1d: {list: [body]}, obs_2d: {list: [front, rear]}}", "`inputs: {obs_1d: [body]}`"),
        ("[body, front, rear]", "in this order: `inputs: {obs_1d: [...], obs_2d: [...]}`"),
        ("{obs_1d: [body], obs_2d: {list: [front]}, x: [rear]}", "2 inputs, the card feeds 3"),
    ],
)
def test_inputs_that_a_script_does_not_take_are_told_in_the_words_of_the_card(
    pictures, inputs, said
):
    with pytest.raises(PolicyError, match=re.escape(said)):
        open_policy(pictures[1](inputs))


def test_a_list_that_is_too_short_is_a_failure_of_the_checkpoint(tmp_path, pictures):
    pictures[1]("{obs_1d: [body], obs_2d: {list: [front, rear]}}")
    text = (tmp_path / "policy.yaml").read_text().replace("[front, rear]", "[front]")
    (tmp_path / "policy.yaml").write_text(text[: text.index("  rear")])
    with pytest.raises(PolicyError, match=r"on an observation of zeros, .* failed: .*range"):
        check_bundle(load_bundle(tmp_path))


class Chooses(torch.nn.Module):
    def forward(self, obs: dict[str, torch.Tensor]) -> torch.Tensor:
        return obs["policy"]


def test_an_argument_that_no_card_can_feed_is_named(tmp_path):
    with pytest.raises(PolicyError, match=r"takes `obs`, a Dict\[str, Tensor\], which no card"):
        open_policy(bundle_of(tmp_path, scripted(Chooses())))


def test_other_adapters_take_no_lists(tmp_path):
    (tmp_path / "policy.pt").write_bytes(b"x")
    text = PICTURES.replace("INPUTS", "{a: [body], b: {list: [front, rear]}}")
    (tmp_path / "policy.yaml").write_text(text.replace("torchscript", "onnx"))
    with pytest.raises(PolicyError, match=r"policy.yaml:7:\d+: .*list of arrays, .*`onnx`"):
        load_bundle(tmp_path)


def test_a_draft_feeds_a_list_of_pictures_one_picture_each(tmp_path, pictures):
    pictures[1]("{obs_1d: [body], obs_2d: {list: [front, rear]}}")
    text = write_card_draft(inspect_checkpoint(tmp_path / "policy.pt"), get_robot("go1"))
    assert "inputs: {obs_1d: [obs_1d], obs_2d: {list: [obs_2d_0, obs_2d_1]}}" in text
    text = text.replace("width: 80", "width: 16").replace("height: 45", "height: 9")
    (tmp_path / "policy.yaml").write_text(text)
    check_bundle(load_bundle(tmp_path))
