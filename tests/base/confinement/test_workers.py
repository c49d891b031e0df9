"""Workers of a run: fenced in, silent, and with the same bits as without a fence."""

import hashlib
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.trial_runs import run_trials

from nw_base.confinement import child_environment, offered
from nw_base.files.cache import cache_dir
from nw_base.trials import expand
from nw_eval.api import check_policy, init_policy
from nw_eval.engine.local import LocalProcesses
from nw_eval.engine.machine import LARGEST, WorkerOutput
from nw_eval.engine.plan import Plan, plan_jobs
from nw_eval.suite.model import new_suite
from nw_gate.results.journal import Journal, JournalHeader
from nw_gate.results.request import Request
from nw_gate.results.run_folder import RunFolder
from nw_policies import load_bundle
from nw_sim.catalogue import FoundScene, get_scene
from nw_sim.rollout.trial import run_trial
from nw_splat.files import write_splat
from nw_splat.gaussians import Gaussians

SCENE = "flat/carpet_room"


def jobs_of(policy, folder, *, scene=SCENE, allow_code=False, record="all"):
    """Return the one job of a tiny run: a fifth of a second in the flat room."""
    bundle, place = load_bundle(policy), FoundScene.at(scene)
    scene = place.scene
    suite = new_suite(
        {
            "nw-eval": 1,
            "name": "tiny",
            "robot": "go1",
            "policy": str(policy),
            "trials": 1,
            "seed": 1,
            "episode": {"duration": 0.2},
            "scenes": [place.reference],
            "record": record,
        }
    )
    if scene.splat is not None:
        scene.splat_store()  # As a run does first: the cache is out of a worker's reach.
    plan = Plan(
        request=Request(allow_code=allow_code),
        suite=suite,
        bundle=bundle,
        found=(place,),
        trials=expand(suite, [scene]),
    )
    return plan_jobs(plan, folder)


def run(jobs, folder):
    header = JournalHeader(suite_digest="s", policy_digest="p", scene_digests={})
    with Journal.create(folder.journal, header) as journal:
        start_workers = LocalProcesses(jobs, folder)
        return run_trials(
            jobs, journal=journal, folder=folder, policy="p", start_workers=start_workers, workers=1
        ).rows


class Standing(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(12, 12)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return 0.1 * torch.tanh(self.layer(x))


@pytest.fixture
def script(tmp_path):
    """Return a bundle with a TorchScript checkpoint."""
    folder = tmp_path / "script"
    folder.mkdir()
    torch.manual_seed(0)
    torch.jit.save(torch.jit.script(Standing()), str(folder / "policy.pt"))
    digest = hashlib.sha256((folder / "policy.pt").read_bytes()).hexdigest()
    (folder / "policy.yaml").write_text(
        "nw-policy: 1\nname: mine\nrobot: go1\nadapter: torchscript\n"
        f"checkpoint: {{file: policy.pt, sha256: {digest}}}\n"
        "control: {action: joint_position_offset}\n"
        "observations: {body: {sensor: proprio, terms: [joint_vel]}}\n"
    )
    return folder


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("kind", ["onnx", "torchscript"])
def test_a_trial_has_the_same_bits_inside_the_fence_as_without(kind, script, tmp_path):
    # Physics, rays, splats, both libraries of networks, and the log.
    policy = "go1-parkour" if kind == "onnx" else script
    folder = RunFolder(path=tmp_path / "run")
    jobs = jobs_of(policy, folder)
    rows = run(jobs, folder)
    assert [row.status for row in rows] == ["ok"], rows[0].error_text
    [log] = folder.path.rglob("*.mcap")
    with child_environment():
        torch.set_num_threads(1)
        outside = run_trial(replace(jobs[0], mcap=tmp_path / "outside.mcap"))
    assert rows[0].state_digest == outside.state_digest
    assert rows[0].action_digest == outside.action_digest
    assert outside.steps == 10
    assert log.stat().st_size == pytest.approx(outside.mcap_bytes, rel=0.01)
    assert sorted(path.name for path in folder.path.iterdir()) == ["journal.jsonl", "mcap"]


SCAN = """\
nw-scene: 1
name: mine/scan
task: hurdles
licence: CC-BY-4.0
trail: [[1.5, 0, 0], [3, 0, 0]]
spawn: {position: [0, 0, 0]}
collision: ground.obj
splat: splat.ply
"""
GROUND = "v -3 -3 0\nv 6 -3 0\nv 6 3 0\nv -3 3 0\nf 1 2 3\nf 1 3 4\n"


def test_a_scan_of_the_users_is_read_in_the_fence_and_its_cache_is_not_written(script, tmp_path):
    place = tmp_path / "scan"
    place.mkdir()
    (place / "scene.yaml").write_text(SCAN)
    (place / "ground.obj").write_text(GROUND)
    rng = np.random.default_rng(0)
    splat = Gaussians(
        means=rng.uniform(-3, 3, (100, 3)).astype(np.float32),
        log_scales=np.full((100, 3), -2, np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (100, 1)),
        opacity_logits=np.ones(100, np.float32),
        sh=rng.uniform(-1, 1, (100, 1, 3)).astype(np.float32),
    )
    write_splat(place / "splat.ply", splat)
    get_scene(place).splat_store()
    folder = RunFolder(path=tmp_path / "run")
    jobs = jobs_of(script, folder, scene=str(place))
    # Files that were there, and not folders: other tests may add to the same cache meanwhile.
    kept = [path for path in cache_dir().rglob("*") if path.is_file()]
    before = [path.stat().st_mtime_ns for path in kept]
    [row] = run(jobs, folder)
    assert (row.status, row.outcome) == ("ok", "timeout"), row.error_text
    assert [path.stat().st_mtime_ns for path in kept] == before


PRINTING = """\
import os

class Policy:
    def __init__(self, bundle): pass
    def act(self, observation):
        print("\\x1b[2J::error::from a policy", flush=True)
        os.write(2, b"from native code\\n")
        return [0.0] * 12
"""


def test_what_a_policy_prints_reaches_a_file_of_the_run_and_not_the_console(tmp_path, capfd):
    (tmp_path / "printing.py").write_text(PRINTING)
    (tmp_path / "policy.yaml").write_text(
        "nw-policy: 1\nname: mine\nrobot: go1\nadapter: python:printing:Policy\n"
        "control: {action: joint_position_offset}\n"
        "observations: {body: {sensor: proprio, terms: [joint_vel]}}\n"
    )
    folder = RunFolder(path=tmp_path / "run")
    rows = run(jobs_of(tmp_path, folder, allow_code=True, record="none"), folder)
    assert [row.status for row in rows] == ["ok"], rows[0].error_text
    assert capfd.readouterr() == ("", "")
    assert folder.workers_log.read_text().splitlines()[:2] == [
        "\\x1b[2J::error::from a policy",
        "from native code",
    ]


def test_of_what_workers_print_a_bounded_part_is_kept_and_nobody_waits(tmp_path):
    path = tmp_path / "workers.log"
    with WorkerOutput(path) as output:
        for _ in range(200):
            os.write(output.end.fileno(), b"x" * 2**16 + b"\n")  # 13 MB; a pipe holds 64 KiB
    kept = path.read_text()
    assert len(kept) <= LARGEST + 100
    with WorkerOutput(path) as output:
        os.write(output.end.fileno(), b"end without a line")
    assert path.read_text().endswith("\nend without a line\n")


def test_a_run_that_prints_nothing_has_no_file_for_it(tmp_path):
    with WorkerOutput(tmp_path / "workers.log"):
        pass
    assert list(tmp_path.iterdir()) == []


DOORS = """\
import json, sys
from pathlib import Path
from nw_eval import api

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    api.check("smoke")
    ran = api.run(
        "smoke", trials=1, scenes=["hurdles/one_low_carpet"], workers=1, out=folder / "run",
        record="none",
    )
    [log] = (folder / "run").rglob("*.mcap")
    replayed = api.replay(log)
    card = api.init_policy(Path(sys.argv[2]), robot="go1", out=folder / "policy.yaml")
    loaded = sorted({"torch", "onnxruntime"} & sys.modules.keys())
    print(json.dumps([loaded, replayed.is_identical, card.text[:40]]))
"""


@pytest.mark.slow
def test_no_door_opens_a_checkpoint_in_the_process_that_was_called(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(DOORS)
    checkpoint = load_bundle("go1-parkour").checkpoint
    done = subprocess.run(
        [sys.executable, script, tmp_path, checkpoint], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    loaded, replayed, _ = json.loads(done.stdout.splitlines()[-1])
    assert loaded == []
    assert replayed is True
    info = json.loads((tmp_path / "run" / "run.json").read_text())
    assert info["fence"] == str(offered())
    report = (tmp_path / "run" / "report.md").read_text()
    assert re.search(rf"\| fence +\| {offered()} +\|", report)


@pytest.mark.skipif(not offered().seccomp, reason="this kernel has no seccomp for us")
def test_a_server_of_policies_is_fenced_in_before_it_says_where_it_is():
    command = ["-c", "from nw_eval.cli import main; main()", "policies", "serve", "stand"]
    server = subprocess.Popen(
        [sys.executable, *command, "--port", "0"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert server.stdout.readline().startswith("serving stand at ws://127.0.0.1:")
        for thread in Path(f"/proc/{server.pid}/task").iterdir():
            assert "\nSeccomp:\t2\n" in (thread / "status").read_text()
    finally:
        server.kill()
        server.communicate()


class Export(torch.nn.Module):
    """Many kinds of layers, whose shapes torch computes in C++ and in Python."""

    def __init__(self):
        super().__init__()
        self.norm, self.rnn = torch.nn.LayerNorm(12), torch.nn.GRU(12, 16)
        self.seen = torch.nn.Sequential(torch.nn.Conv1d(1, 4, 3), torch.nn.BatchNorm1d(4))
        self.head = torch.nn.Sequential(
            *(torch.nn.Linear(56, 16), torch.nn.ELU(), torch.nn.Linear(16, 16), torch.nn.SiLU()),
            *(torch.nn.Linear(16, 12), torch.nn.Tanh()),
        )
        self.register_buffer("hidden", torch.zeros(1, 1, 16))

    def forward(self, obs):
        obs = self.norm(obs.clamp(-5.0, 5.0))
        seen = torch.nn.functional.softplus(self.seen(obs[:, None])).flatten(1)
        out, hidden = self.rnn(obs[None], self.hidden)
        self.hidden.copy_(hidden)
        return 0.1 * self.head(torch.cat([torch.nn.functional.gelu(seen), out[0]], dim=1))


PT2 = """\
nw-policy: 1
name: exported
robot: go1
adapter: torch-export
checkpoint: {file: policy.pt2}
control: {action: joint_position_offset}
observations: {body: {sensor: proprio, terms: [joint_pos]}}
"""


@pytest.mark.skipif(not offered().landlock, reason="this kernel has no Landlock for us")
def test_an_exported_graph_is_drafted_checked_and_run_behind_the_fence(tmp_path):
    file = tmp_path / "policy.pt2"
    graph = torch.export.export(Export().eval(), (torch.zeros(1, 12),))
    torch.export.save(graph, file)
    draft = init_policy(file, robot="go1", out=tmp_path / "draft.yaml")
    assert "adapter: torch-export" in draft.text
    (tmp_path / "policy.yaml").write_text(PT2)
    report = check_policy(str(tmp_path / "policy.yaml"), scene=SCENE)
    assert report.seconds == pytest.approx(1.0)
    folder = RunFolder(path=tmp_path / "run")
    [row] = run(jobs_of(str(tmp_path), folder), folder)
    assert (row.status, row.error_text) == ("ok", "")
