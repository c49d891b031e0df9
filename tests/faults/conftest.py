"""A tiny run: the flat room, a fifth of a second a trial, and policies that misbehave."""

import hashlib
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from tests.trial_runs import run_trials

from nw_base.protocol import STRICT
from nw_base.trials import expand
from nw_eval.engine.local import LocalProcesses
from nw_eval.engine.plan import Plan, plan_jobs
from nw_eval.suite.model import new_suite
from nw_gate.results.journal import Journal, JournalHeader
from nw_gate.results.request import Request
from nw_gate.results.run_folder import RunFolder
from nw_policies import load_bundle
from nw_sim.catalogue import FoundScene
from nw_sim.rollout.confined import start
from nw_sim.tasks.course import draw_start

SCENE = "flat/carpet_room"
# Index of delta_yaw among the numbers of `parkour53`: its sign differs from trial to trial.
DELTA_YAW = 6


@pytest.fixture
def workers():
    """Return what gives the numbers of all worker processes of this one."""
    return worker_numbers


def worker_numbers():
    fork_server = start._fork_server
    forked = [] if fork_server is None else children_of(fork_server._process.pid)
    return [child.pid for child in active_children() if not child.daemon] + forked


def children_of(parent):
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == parent:
            found.append(int(path.parent.name))
    return found


def chosen_by_sign(if_positive, otherwise):
    """Return nodes that make `choice` (int64 scalar) of the sign of delta_yaw."""
    constants = [
        numpy_helper.from_array(np.array([DELTA_YAW]), "index"),
        numpy_helper.from_array(np.array([0.0], np.float32), "zero"),
        numpy_helper.from_array(np.array([if_positive], np.int64), "yes"),
        numpy_helper.from_array(np.array([otherwise], np.int64), "no"),
    ]
    nodes = [
        helper.make_node("Gather", ["obs", "index"], ["yaw"], axis=1),
        helper.make_node("Greater", ["yaw", "zero"], ["positive"]),
        helper.make_node("Where", ["positive", "yes", "no"], ["choices"]),
        helper.make_node("ReduceMax", ["choices"], ["choice"], keepdims=0),
    ]
    return nodes, constants


def looping(if_positive, otherwise):
    """Return a model that counts up to one of two numbers before it answers with zeros."""
    nodes, constants = chosen_by_sign(if_positive, otherwise)
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go_on"], ["go_on_out"]),
            helper.make_node("Sin", ["value"], ["value_out"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("i", TensorProto.INT64, []),
            helper.make_tensor_value_info("go_on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("value", TensorProto.FLOAT, [1, 12]),
        ],
        [
            helper.make_tensor_value_info("go_on_out", TensorProto.BOOL, []),
            helper.make_tensor_value_info("value_out", TensorProto.FLOAT, [1, 12]),
        ],
    )
    constants += [
        numpy_helper.from_array(np.array(True), "always"),
        numpy_helper.from_array(np.zeros((1, 12), np.float32), "start"),
    ]
    nodes.append(helper.make_node("Loop", ["choice", "always", "start"], ["action"], body=body))
    return nodes, constants


def going_nan(if_positive):
    """Return a model that answers with NaN in some trials, in all of them or in none."""
    nodes, constants = chosen_by_sign(0 if if_positive else 1, 1)
    constants.append(numpy_helper.from_array(np.zeros((1, 12), np.float32), "numerator"))
    nodes += [
        helper.make_node("Cast", ["choice"], ["denominator"], to=TensorProto.FLOAT),
        helper.make_node("Div", ["numerator", "denominator"], ["action"]),
    ]
    return nodes, constants


MODELS = {
    "slow": lambda: looping(20_000, 20_000),  # takes some time
    "hangs": lambda: looping(10**13, 1),  # in trials that start with the waypoint on the left
    "nan": lambda: going_nan(if_positive=True),
    "fine": lambda: going_nan(if_positive=False),
}

CARD = """\
nw-policy: 1
name: {name}
robot: go1
adapter: onnx
checkpoint: {{file: policy.onnx, sha256: {sha256}}}
control: {{action: joint_position_offset, scale: 0.25, delay_steps: 1}}
observations:
  proprio: {{sensor: proprio, layout: parkour53}}
"""


def write_bundle(folder, name):
    """Write a bundle of one of the models, and return its folder."""
    nodes, constants = MODELS[name]()
    graph = helper.make_graph(
        nodes,
        name,
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 53])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 12])],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.checker.check_model(model)
    folder.mkdir(parents=True)
    data = model.SerializeToString()
    (folder / "policy.onnx").write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    (folder / "policy.yaml").write_text(CARD.format(name=name, sha256=digest))
    return folder


PYTHON_CARD = """\
nw-policy: 1
name: {name}
robot: go1
adapter: python:{name}:Policy
control: {{action: joint_position_offset, scale: 0.25, delay_steps: 1}}
observations:
  proprio: {{sensor: proprio, layout: parkour53{wrapped}}}
"""

PYTHON_POLICY = """\
import fcntl, os, stat, subprocess, sys
from pathlib import Path

def pipes():
    for fd in range(3, 64):
        try:
            is_pipe = stat.S_ISFIFO(os.fstat(fd).st_mode)
        except OSError:
            continue
        if is_pipe and fcntl.fcntl(fd, fcntl.F_GETFL) & os.O_WRONLY:
            yield fd

class Odd(BaseException):
    def __init__(self, one, two):
        super().__init__("odd")

class Counted:
    folder = Path(__file__).parent

    def __init__(self, *_):
        self.step = 0

    def reset(self, seed):
        self.step = 0

    def count(self):
        self.step += 1
        if self.step == 3:
            {deed}

class Policy(Counted):
    def act(self, observation):
        {acts}
        return [0.0] * 12

class Wrap(Counted):
    def __call__(self, sample, shot):
        if shot.moment is not None:
            {measures}
        return sample
"""


def write_python_bundle(folder, name, deed, *, by="policy"):
    """Write a policy that stands, but for what it, or its sensor, does at the third step.

    The policy's code runs behind the fence, in the policy's process; that of a sensor in the
    world's, which has none then.
    """
    folder.mkdir(parents=True)
    wrapped = f", wrap: [{{wrapper: '{name}:Wrap'}}]" if by == "sensor" else ""
    (folder / "policy.yaml").write_text(PYTHON_CARD.format(name=name, wrapped=wrapped))
    counts, rests = "self.count()", "pass"
    acts, measures = (counts, rests) if by == "policy" else (rests, counts)
    code = PYTHON_POLICY.format(deed=deed, acts=acts, measures=measures)
    (folder / f"{name}.py").write_text(code)
    return folder


def suite_with_both_sides(scene, settings):
    """Return the suite of the first seed whose trials start with the waypoint left and right."""
    for seed in range(1000):
        suite = new_suite({**settings, "seed": seed})
        starts = [
            draw_start(
                trial,
                protocol=STRICT,
                spawn=(*scene.spawn.position[:2], scene.spawn.yaw),
                jitter=(scene.spawn.x_jitter, scene.spawn.y_jitter, scene.spawn.yaw_jitter),
                trail=scene.trail,
                waypoint_noise=scene.waypoint_noise,
            )
            for trial in expand(suite, [scene])
        ]
        sides = {
            np.arctan2(start.waypoints[0][1] - start.y, start.waypoints[0][0] - start.x) > start.yaw
            for start in starts
        }
        if sides == {True, False} or len(starts) == 1:
            return suite
    raise AssertionError("no panel of a thousand starts on both sides")


class Ears:
    """A listener that remembers, and calls `heard` with each message."""

    def __init__(self):
        self.messages = []
        self.rows = []
        self.heard = len

    def message(self, text):
        self.messages.append(text)
        self.heard(text)

    def scene(self, name, fraction):
        pass

    def planned(self, *, total, finished):
        self.total, self.already = total, finished

    def trial(self, row):
        self.rows.append(row)


@dataclass
class TinyRun:
    """A run of one scene: its jobs, its folder, and what was heard."""

    folder: RunFolder
    jobs: tuple
    header: JournalHeader
    policy: str
    memory_limit: int | None = None
    ears: Ears = field(default_factory=Ears)

    def go(self, *, workers=2, resume=False):
        open_journal = Journal.resume if resume else Journal.create
        with open_journal(self.folder.journal, self.header) as journal:
            return run_trials(
                self.jobs,
                journal=journal,
                folder=self.folder,
                policy=self.policy,
                start_workers=LocalProcesses(
                    self.jobs, self.folder, memory_limit=self.memory_limit
                ),
                workers=workers,
                listener=self.ears,
            )

    @contextmanager
    def pool(self):
        """One worker, for those who want to see what comes out of it."""
        start_workers = LocalProcesses(self.jobs, self.folder, memory_limit=self.memory_limit)
        with start_workers(1, fresh=False) as workers:
            yield workers


@pytest.fixture
def tiny_run(tmp_path):
    """Return a maker of runs: `tiny_run("slow", trials=4)`, `tiny_run("leaver", deed="exit()")`."""

    def make(
        model,
        *,
        name="run",
        trials=4,
        duration=0.2,
        time_limit=60.0,
        memory_limit=None,
        record="none",
        deed=None,
        by="policy",
        code=None,
    ):
        bundles: Path = code or tmp_path / "policies" / model
        if deed is not None:
            write_python_bundle(bundles, model, deed, by=by)
        elif not bundles.exists():
            write_bundle(bundles, model)
        bundle = load_bundle(bundles)
        place = FoundScene.at(SCENE)
        scene = place.scene
        suite = suite_with_both_sides(
            scene,
            {
                "nw-eval": 1,
                "name": "tiny",
                "robot": "go1",
                "policy": str(bundles),
                "trials": trials,
                "episode": {"duration": duration},
                "scenes": [SCENE],
                "record": record,
            },
        )
        folder = RunFolder(path=tmp_path / name)
        plan = Plan(
            request=Request(
                time_limit=time_limit,
                memory_limit=memory_limit,
                allow_code=deed is not None or code is not None,
            ),
            suite=suite,
            bundle=bundle,
            found=(place,),
            trials=expand(suite, [scene]),
        )
        jobs = plan_jobs(plan, folder)
        header = JournalHeader(
            suite_digest=suite.digest,
            policy_digest=bundle.digest,
            scene_digests={scene.name: scene.digest},
        )
        return TinyRun(
            folder=folder,
            jobs=jobs,
            header=header,
            policy=bundle.name,
            memory_limit=plan.memory_limit,
        )

    return make
