import hashlib
import io
import os
import zipfile

import numpy as np
import pytest
import torch

from nw_eval.errors import PolicyError, TrialError
from nw_eval.policies import load_bundle, open_policy
from nw_eval.policies.adapters import torchscript

CARD = """\
nw-policy: 1
name: mine
robot: go1
adapter: torchscript
checkpoint: {file: policy.pt, sha256: %s}
control: {action: joint_position_offset, scale: 0.25}
observations: {body: {sensor: proprio, terms: [joint_pos]}}
"""


def bundle_of(folder, data):
    (folder / "policy.pt").write_bytes(data)
    (folder / "policy.yaml").write_text(CARD % hashlib.sha256(data).hexdigest())
    return load_bundle(folder)


# torch recommends torch.export for new files; people have these.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def scripted(module):
    buffer = io.BytesIO()
    torch.jit.save(torch.jit.script(module), buffer)
    return buffer.getvalue()


class Doubling(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return 2.0 * x


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
        return torch.from_file("/etc/passwd", False, x.numel(), dtype=torch.uint8)


@pytest.mark.parametrize(("module", "operator"), [(Writing(), "save"), (Reading(), "from_file")])
def test_a_script_that_touches_files_is_refused(tmp_path, monkeypatch, module, operator):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PolicyError, match=f"names the operator `{operator}`"):
        open_policy(bundle_of(tmp_path, scripted(module)))
    assert not (tmp_path / "written.pt").exists()


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
    with pytest.raises(PolicyError, match="not a usable TorchScript file"):
        open_policy(bundle_of(tmp_path, buffer.getvalue()))
    assert not mark.exists()


def test_a_state_dict_is_answered_with_how_to_save(tmp_path):
    torch.save({"weight": torch.zeros(3)}, tmp_path / "state.pt")
    with pytest.raises(PolicyError, match=r"state dict.*torch\.jit\.save"):
        open_policy(bundle_of(tmp_path, (tmp_path / "state.pt").read_bytes()))


def test_an_archive_that_unpacks_to_too_much_is_refused_before_unpacking(tmp_path, monkeypatch):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("m/constants.pkl", bytes(5_000_000))
    assert len(buffer.getvalue()) < 10_000
    monkeypatch.setattr(torchscript, "SIZE_LIMIT", 4_000_000)
    with pytest.raises(PolicyError, match="unpacks to 5 MiB"):
        open_policy(bundle_of(tmp_path, buffer.getvalue()))


def test_an_archive_with_members_outside_is_refused(tmp_path):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("../../evil", b"x")
    with pytest.raises(PolicyError, match=r"has the member '\.\./\.\./evil'"):
        open_policy(bundle_of(tmp_path, buffer.getvalue()))


def test_bytes_that_are_no_archive_are_refused(tmp_path):
    with pytest.raises(PolicyError, match="it is no archive"):
        open_policy(bundle_of(tmp_path, b"nothing"))
