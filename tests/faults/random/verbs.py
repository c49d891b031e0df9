"""Verbs that are killed at any moment: what each begins with, and the words that begin it again.

A verb is given its inputs in a folder of its own, in which it runs, and writes to `out`. After a
kill the same words are given again, or those that the verb itself names.
"""

import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

TESTS = Path(__file__).parents[2]
sys.path += [str(TESTS / "twin"), str(TESTS / "twin" / "label"), str(TESTS / "learn" / "student")]

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: {policy}
trials: 4
seed: 7
episode: {{duration: 0.2}}
scenes: [flat/carpet_room]
record: none
gate: {{success_rate: 0.9}}
"""
TEACHER = """\
nw-train: 1
seed: 1
budget: {steps: 640}
ppo: {robots: 4, horizon: 8, minibatches: 2, epochs: 1, critic_first: 0}
courses: {variants: 1, levels: 1, start: [0, 0], scenes: [hurdles/one_low_carpet]}
overlap: false
phases:
  - {share: 1.0, timestep: 0.01, std: 0.2,
     tasks: {hurdles: 1.0, gaps: 0.0, ramps: 0.0, stairs: 0.0, flat: 0.0}}
"""
PASSED, REGRESSED = 0, 1


@dataclass(frozen=True)
class Verb:
    """One that is killed.

    Attributes:
        words: of the command line, from the verb on.
        inputs: writes what it reads into a folder; runs other verbs by a function that it is given.
        code: it ends with.
        resume: words to go on with, where the same words are refused.
        deed: run in place of the command line, in the folder.
        imports: modules that it needs, which a fork has then; None = it is a process of its own.
    """

    words: tuple
    inputs: Callable
    code: int = PASSED
    resume: tuple = ()
    deed: Callable | None = None
    imports: tuple | None = ()


def suite(folder, run=None, *, policy="stand"):  # noqa: ARG001 - all inputs are made alike.
    (folder / "tiny.yaml").write_text(SUITE.format(policy=policy))


def checkpoints(folder, _run):
    """A card, and three checkpoints of a training, each of other bytes."""
    import onnx
    from origins import _bundles

    bundle = _bundles().write_bundle(folder / "policy", "fine")
    (folder / "training").mkdir()
    model = onnx.load(bundle / "policy.onnx")
    for step in (100, 200, 300):
        model.doc_string = f"step {step}"
        (folder / "training" / f"model_{step}.onnx").write_bytes(model.SerializeToString())
    suite(folder, policy="./policy")


def parts(folder, run):
    suite(folder)
    for number in (1, 2):
        run("run", "tiny.yaml", "--shard", f"{number}/2", "--out", f"part-{number}", "-j", 1)


def runs(folder, run):
    suite(folder)
    for number in (1, 2):
        run("run", "tiny.yaml", "--seed", number, "--out", f"run-{number}", "-j", 1)


def teacher(folder, _run):
    (folder / "mine.yaml").write_text(TEACHER)


def student(folder, _run):
    from student_parts import SMALL

    (folder / "pupil.yaml").write_text(SMALL)


def photographs(folder, _run):
    import cv2
    from synthetic_room import cameras, render, room

    (folder / "photographs").mkdir()
    for number, camera in enumerate(cameras(12, width=240, height=136)):
        picture = render(room(0), camera)[..., ::-1]
        cv2.imwrite(str(folder / "photographs" / f"{number:02}.png"), picture)


def place(folder, _run):
    from label_places import written_place

    written_place(folder / "out")


def save_often():
    """Save a scene's labels again and again, as a person does; the last ones are always these."""
    from nw_twin.label.labelling import open_labelling

    labelling = open_labelling(Path("out"))
    for number in range(40):
        labelling.nudge_waypoint(1, 0.25 if number % 2 else -0.25, 0.0)
        labelling.save()
    x, *_ = labelling.state.waypoints[1]
    labelling.nudge_waypoint(1, 4.5 - x, 0.0)
    labelling.save()
    sys.stdout.flush()
    os._exit(0)


TINY = (
    *("--camera-height", 1.4, "--side", 240, "--depth-side", 64, "--iterations", 40),
    *("--gaussians", 800, "--longest", 64, "--features", 1000, "--faces", 2000, "-j", 1),
)

VERBS = {
    "watch": Verb(
        (
            *("watch", "training", "--suite", "tiny.yaml", "--policy", "policy", "--once"),
            *("--interval", 0.1, "-j", 2, "--out", "out"),
        ),
        checkpoints,
        code=REGRESSED,
    ),
    "merge": Verb(("merge", "part-1", "part-2", "--out", "out"), parts, code=REGRESSED),
    "baseline save": Verb(
        ("baseline", "save", "tiny.yaml", "--name", "mine", "-n", 6, "-j", 2), suite
    ),
    "report --site": Verb(("report", "run-1", "run-2", "--site", "out", "--no-pictures"), runs),
    "verify": Verb(("verify", "run-1", "--trials", "100%", "-j", 2), runs),
    "train teacher": Verb(
        ("train", "teacher", "mine.yaml", "--out", "out"),
        teacher,
        resume=("train", "teacher", "--resume", "out"),
        imports=("torch", "matplotlib.pyplot", "nw_learn.teacher.training"),
    ),
    "train student": Verb(
        ("train", "student", "pupil.yaml", "--out", "out", "-j", 2),
        student,
        resume=("train", "student", "--resume", "out", "-j", 2),
        imports=("torch", "matplotlib.pyplot", "nw_learn.student.train"),
    ),
    "twin label": Verb((), place, deed=save_often, imports=("nw_twin.label.labelling",)),
    "twin build": Verb(
        ("twin", "build", "photographs", "--out", "out", *TINY),
        photographs,
        imports=None,
    ),
}


def copied(inputs, folder):
    """Return a new folder with the inputs of a verb."""
    shutil.copytree(inputs, folder, symlinks=True)
    return folder
