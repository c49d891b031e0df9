"""The tutorials' commands do, as they stand, what the pages say."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Mapping

ROOT = Path(__file__).parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"
ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", ROOT.parent / "shared" / "assets"))
GO1 = ASSETS / "policies" / "playground-go1" / "go1_policy.onnx"
B2 = ASSETS / "robots" / "b2"

_BLOCK = re.compile(r"^```([\w-]*)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)

TRAINING = "logs/rsl_rl/go1_velocity/2026-11-20_14-03-11"
"""The folder of the training in `checkpoint-to-check.md`."""

DEPLOY = """\
joint_ids_map: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]
step_dt: 0.02
stiffness: [35, 35, 35, 35, 35, 35, 35, 35, 35, 35, 35, 35]
damping: [.5, .5, .5, .5, .5, .5, .5, .5, .5, .5, .5, .5]
default_joint_pos: [.1, .9, -1.8, -.1, .9, -1.8, .1, .9, -1.8, -.1, .9, -1.8]
commands:
  base_velocity:
    ranges: {lin_vel_x: [-1.5, 1.5], lin_vel_y: [-0.8, 0.8], ang_vel_z: [-1.2, 1.2], heading: null}
actions:
  JointPositionAction:
    clip: null
    joint_names: [.*]
    scale: [.5, .5, .5, .5, .5, .5, .5, .5, .5, .5, .5, .5]
    offset: [.1, .9, -1.8, -.1, .9, -1.8, .1, .9, -1.8, -.1, .9, -1.8]
    joint_ids: null
observations:
  base_lin_vel: {params: {}, clip: null, scale: [1, 1, 1], history_length: 1}
  base_ang_vel: {params: {}, clip: null, scale: [1, 1, 1], history_length: 1}
  projected_gravity: {params: {}, clip: null, scale: [1, 1, 1], history_length: 1}
  joint_pos_rel: {scale: [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1], history_length: 1}
  joint_vel_rel: {scale: [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1], history_length: 1}
  last_action: {scale: [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1], history_length: 1}
  velocity_commands: {params: {}, clip: null, scale: [1, 1, 1], history_length: 1}
"""
"""What unitree_rl_mjlab would write beside Playground's policy, by its publisher's code."""

ENVIRONMENT = """\
decimation: 4
sim: {dt: 0.005}
scene:
  robot:
    init_state:
      joint_pos: {.*_thigh_joint: 0.9, .*_calf_joint: -1.8, .*R_hip_joint: 0.1, .*L_hip_joint: -0.1}
    actuators:
      legs:
        joint_names_expr: [.*_hip_joint, .*_thigh_joint, .*_calf_joint]
        effort_limit: {.*_hip_joint: 23.7, .*_thigh_joint: 23.7, .*_calf_joint: 35.55}
        stiffness: 35.0
        damping: 0.5
        armature: 0.005
observations:
  policy:
    velocity: {func: "isaaclab.envs.mdp.observations:generated_commands", clip: null, scale: null}
actions: {}
"""


def script_of(page: str) -> str:
    """A page as one script: its files are written where their names say, its commands run."""
    parts: list[str] = []
    for kind, name, body in _BLOCK.findall((TUTORIALS / page).read_text(encoding="utf-8")):
        if name:
            parts.append(f"mkdir -p {Path(name).parent}\ncat > {name} <<'EOF'\n{body}EOF\n")
        elif kind == "bash":
            parts.append(body)
    return "set -eo pipefail\n" + "\n".join(parts)


def follow(
    page: str, folder: Path, changes: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Follow a page in a folder, word for word, as a reader whose shell has nw-eval does.

    Args:
        page: of the tutorials.
        folder: in which the reader works.
        changes: pieces of the script, and what this reader types instead.
    """
    script = script_of(page)
    for old, new in (changes or {}).items():
        assert old in script, old
        script = script.replace(old, new)
    identity = {
        f"GIT_{who}_{what}": "reader@example.com"
        for who in ("AUTHOR", "COMMITTER")
        for what in ("NAME", "EMAIL")
    }
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-c", script],
        cwd=folder,
        env={**os.environ, **identity, "PATH": path, "COLUMNS": "120"},
        capture_output=True,
        text=True,
        check=False,
        timeout=3000,
    )


def outputs_of(page: str) -> list[str]:
    """What a page says that its commands print, line by line."""
    blocks = _BLOCK.findall((TUTORIALS / page).read_text(encoding="utf-8"))
    return [line.rstrip() for kind, _, body in blocks if not kind for line in body.splitlines()]


def timeless(text: str) -> str:
    """Text without what another machine measures, in one line."""
    return re.sub(r"· [\d.]+ (s|min) on \d+ workers", "", " ".join(text.split()))


@pytest.fixture
def training(tmp_path: Path) -> Path:
    """The folder of a training beside which the reader begins."""
    if not GO1.exists():
        pytest.skip("needs the published Go1 policy")
    (tmp_path / TRAINING / "exported").mkdir(parents=True)
    (tmp_path / TRAINING / "params").mkdir()
    (tmp_path / TRAINING / "exported" / "policy.onnx").write_bytes(GO1.read_bytes())
    (tmp_path / TRAINING / "params" / "deploy.yaml").write_text(DEPLOY)
    (tmp_path / TRAINING / "params" / "env.yaml").write_text(ENVIRONMENT)
    return tmp_path


@pytest.mark.nightly
def test_a_checkpoint_becomes_a_required_check(training: Path) -> None:
    page = "checkpoint-to-check.md"
    followed = follow(page, training)
    said = followed.stdout + followed.stderr
    assert followed.returncode == 0, said
    verdicts = [line for line in followed.stdout.splitlines() if " · same policy as " in line]
    last = verdicts[-1]
    assert last.startswith("PASS · same policy as baseline shipped"), "the check's own word"
    # The gate failed, too, where the page says so.
    assert "exit code 1\n" in followed.stdout
    printed = timeless(followed.stdout)
    for line in outputs_of(page):
        assert timeless(line) in printed, line
    card = (training / "policies/walk/policy.yaml").read_text()
    shown = _BLOCK.findall((TUTORIALS / page).read_text())
    (lines,) = [body for kind, name, body in shown if kind == "yaml" and not name]
    assert all(line in card for line in lines.splitlines())
    assert card.count("# CHECK: ") == 3, "as many as the page counts"
    kept = subprocess.run(
        ["git", "ls-files"], cwd=training, capture_output=True, text=True, check=True
    )
    assert "reports/baselines/walk/shipped.parquet" in kept.stdout
    assert not re.search(r"^(reports/(?!baselines)|logs/)", kept.stdout, re.MULTILINE)
    assert (training / "gate.xml").exists()


COMMAND_FIRST = (
    r"sed -i '/{term: command, scale/d; s/^\( *\)- {term: ang_vel, scale: 0.25}/"
    r"\1- {term: command, scale: [2.0, 2.0, 0.25]}\n&/' policies/walk/policy.yaml"
)
"""What `policies check` says of legubiao's policy, as an edit."""


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("robot", "policy", "more", "scenes"),
    [
        ("go2", "legubiao-go2", COMMAND_FIRST, "[flat/carpet_room, ramps/one_ramp_plaza]"),
        ("g1", "g1-unitree-rl-gym", "", "[flat/carpet_room]"),
    ],
)
def test_other_public_checkpoints_become_a_required_check(
    tmp_path: Path, robot: str, policy: str, more: str, scenes: str
) -> None:
    """The same page, by readers with another robot, who type what it tells them to."""
    published = ASSETS / "policies" / policy / "policy.pt"
    if not published.exists():
        pytest.skip("needs the published policy")
    (tmp_path / TRAINING / "exported").mkdir(parents=True)
    (tmp_path / TRAINING / "params").mkdir()
    shutil.copy(published, tmp_path / TRAINING / "exported" / "policy.pt")
    made = f"nw-eval policies init policies/walk --robot {robot}\n{more}\n"
    if robot == "g1":
        model = ASSETS / "robots" / "g1" / "g1_12dof.xml"
        made = f"nw-eval robots init {model} --out robots/g1\n{made}"
    changes = {
        "exported/policy.onnx": "exported/policy.pt",
        "nw-eval policies init policies/walk --robot go1\n": made,
        "robot: go1 ": f"robot: {robot} ",
        "[flat/carpet_room, ramps/one_ramp_plaza, ramps/two_ramps_park]": scenes,
        "trials: 10 ": "trials: 20 ",
        "git add .gitignore": f"git add {'robots' if robot == 'g1' else ''} .gitignore",
    }
    followed = follow("checkpoint-to-check.md", tmp_path, changes)
    said = followed.stdout + followed.stderr
    assert followed.returncode == 0, said
    assert "no fault found" in followed.stdout
    verdicts = [line.split(" ")[0] for line in followed.stdout.splitlines() if " · " in line]
    assert [each for each in verdicts if each in {"PASS", "REGRESSED"}] == [
        "PASS", "REGRESSED", "PASS",
    ], said  # fmt: skip
    assert "exit code 1\n" in followed.stdout
    assert "same policy as baseline shipped" in followed.stdout


@pytest.mark.nightly
def test_your_own_robot_walks(tmp_path: Path) -> None:
    page = "your-own-robot.md"
    policy = ASSETS / "policies" / "b2-robot-lab" / "policy.pt"
    if not (B2.exists() and policy.exists()):
        pytest.skip("needs the published B2 and its policy")
    shutil.copytree(B2, tmp_path / "model")
    (tmp_path / "checkpoint").mkdir()
    shutil.copy(policy, tmp_path / "checkpoint" / "policy.pt")
    followed = follow(page, tmp_path)
    assert followed.returncode == 0, followed.stdout + followed.stderr
    printed = timeless(followed.stdout)
    for line in outputs_of(page):
        assert timeless(line) in printed, line


def weaker(onnx_file: bytes, share: float) -> bytes:
    """A policy's file with the weights of its layers scaled: a checkpoint of the same form."""
    import numpy as np
    import onnx
    from onnx import numpy_helper

    model = onnx.load_from_string(onnx_file)
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.ndim == 2:
            scaled = numpy_helper.from_array((share * values).astype(np.float32), tensor.name)
            tensor.CopyFrom(scaled)
    return model.SerializeToString()


@pytest.mark.nightly
@pytest.mark.timeout(3000)
def test_ten_checkpoints_are_compared(training: Path) -> None:
    """The first tutorial's card and suite, and ten checkpoints of which the last is worse."""
    first = script_of("checkpoint-to-check.md").partition("nw-eval run suites/walk.yaml")[0]
    commands = [
        line for line in first.splitlines() if not line.startswith("nw-eval policies check")
    ]
    page = "compare-checkpoints.md"
    (training / "checkpoints").mkdir()
    whole = GO1.read_bytes()
    for number in range(1, 11):
        share = 1.0 if number in {4, 7, 8, 9} else 0.5
        file = training / "checkpoints" / f"model_{100 * number}.onnx"
        file.write_bytes(whole if share == 1.0 else weaker(whole, share))
    prepared = "\n".join(commands)
    followed = follow(
        page,
        training,
        {
            "set -eo pipefail\n": prepared + "\n",
            # A verdict that is no PASS ends neither the reader's shell nor this script.
            "--once --out reports/ten\n": "--once --out reports/ten || echo watch $?\n",
            "--bad checkpoints/model_1000.onnx\n": (
                "--bad checkpoints/model_1000.onnx || echo bisect $?\n"
            ),
        },
    )
    said = followed.stdout + followed.stderr
    assert followed.returncode == 0, said
    assert "10 checkpoints; best: model_" in followed.stdout
    assert "page: reports/ten/index.html" in followed.stdout
    assert "watch 1\n" in followed.stdout, "the newest checkpoint is REGRESSED"
    assert re.search(r"^policy +rank +success", followed.stdout, re.MULTILINE)
    held_out = "* success is at least 0."
    assert held_out in followed.stdout
    assert "the first flagged: checkpoints/model_1000.onnx" in followed.stdout
    assert "bisect 1\n" in followed.stdout


@pytest.mark.nightly
@pytest.mark.timeout(3000)
def test_photographs_become_a_scene_in_which_a_policy_walks(tmp_path: Path) -> None:
    """Forty photographs of a built-in course, as a phone takes them, with a tag of 0.24 m."""
    sys.path.insert(0, str(ROOT / "tests" / "twin" / "loop"))
    from closed_loop import photograph

    photograph("hurdles/one_low_carpet", tmp_path / "photographs")
    page = "your-corridor.md"
    followed = follow(
        page,
        tmp_path,
        {
            "pip install -c constraints.txt -e '.[twin]'\n": "",
            "--tag-edge 0.16": "--tag-edge 0.24 --iterations 300 --longest 240 --gaussians 20000",
            # Pages that are served until Ctrl-C.
            "nw-eval twin label corridor\n": "",
            "nw-eval view ./corridor\n": "",
            # The verdict of a policy is not the page's claim.
            "--policy go1-act-rgb\n": "--policy go1-act-rgb || echo images $?\n",
        },
    )
    assert followed.returncode == 0, followed.stdout + followed.stderr
    told = (TUTORIALS / page).read_text(encoding="utf-8")
    for name in re.findall(r"^\| `(corridor/\S+)` \|", told, re.MULTILINE):
        assert (tmp_path / name).exists(), name
    assert (tmp_path / "corridor.png").stat().st_size > 10_000
    assert re.search(r"^PASS · ", followed.stdout, re.MULTILINE), "go1-parkour walks in it"
    assert "my-places" in followed.stdout
