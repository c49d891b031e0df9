"""Checkpoints that are programs are opened in a process of their own, never in this one."""

import os
from multiprocessing import active_children

import pytest
import torch

from nw_base.errors import CrashError, PolicyError, SceneError
from nw_policies import load_bundle
from nw_sim.rollout.confined import vetting
from nw_sim.rollout.confined.isolated import call_isolated

# Functions travel to another process by name, so they must live in a module that it can import.
MODULE = "isolated_functions"
SOURCE = """\
import os, time
from nw_base.confinement import processor_time
from nw_base.errors import SceneError

def pid(): return os.getpid()
def dies(): os._exit(7)
def aborts(): os.abort()
def loops():
    with processor_time(1):
        while True: pass
def sleeps(): time.sleep(600)
def no_scene(): raise SceneError('there is no floor', fix='add one')
def breaks(): raise KeyError('x')
"""


@pytest.fixture
def functions(tmp_path, monkeypatch):
    (tmp_path / f"{MODULE}.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(str(tmp_path))
    return __import__(MODULE)


def test_a_call_runs_elsewhere(functions):
    assert call_isolated(functions.pid, subject="x") != os.getpid()


def test_a_process_that_dies_is_an_error_of_the_policy(functions):
    with pytest.raises(PolicyError, match=r"card: the process .* died \(exit code 7\)"):
        call_isolated(functions.dies, subject="card")


def test_a_process_that_aborts_is_no_mistake_of_the_user(functions):
    with pytest.raises(CrashError, match=r"died \(SIGABRT, exit code -6\)") as caught:
        call_isolated(functions.aborts, subject="card")
    assert caught.value.exit_code == 4


def test_a_part_of_a_call_has_a_limit_of_processor_time_of_its_own(functions):
    with pytest.raises(PolicyError, match="more processor time than it may") as caught:
        call_isolated(functions.loops, subject="card")
    assert caught.value.exit_code == 2


def test_a_process_that_hangs_is_ended(functions):
    before = {child.pid for child in active_children()}
    with pytest.raises(PolicyError, match="no answer from the checkpoint within 1 s"):
        call_isolated(functions.sleeps, subject="card", time_limit=1.0)
    assert {child.pid for child in active_children()} == before


def test_errors_keep_their_class_and_words(functions):
    with pytest.raises(SceneError, match="there is no floor; add one"):
        call_isolated(functions.no_scene, subject="card")
    with pytest.raises(PolicyError, match="KeyError: 'x'"):
        call_isolated(functions.breaks, subject="card")


class Doubling(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return 2.0 * x


CARD = """\
nw-policy: 1
name: mine
robot: go1
adapter: torchscript
checkpoint: {file: policy.pt}
control: {action: joint_position_offset}
observations: {body: {sensor: proprio, terms: [%s]}}
"""


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_script_is_vetted_without_being_loaded_here(tmp_path, monkeypatch):
    torch.jit.save(torch.jit.script(Doubling()), str(tmp_path / "policy.pt"))

    def refuse(*_, **__):
        raise AssertionError("a script was loaded in the parent")

    monkeypatch.setattr(torch.jit, "load", refuse)
    monkeypatch.setattr(vetting, "check_bundle", refuse)  # Of this process alone.
    (tmp_path / "policy.yaml").write_text(CARD % "joint_vel")
    vetting.vet_bundle(load_bundle(tmp_path, checkpoint=tmp_path / "policy.pt"), "go1")
    (tmp_path / "policy.yaml").write_text(CARD % "gravity")
    with pytest.raises(PolicyError, match=r"on an observation of zeros, .*compare with what"):
        vetting.vet_bundle(load_bundle(tmp_path, checkpoint=tmp_path / "policy.pt"), "go1")
