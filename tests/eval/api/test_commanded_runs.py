"""Suites of the tasks that command a velocity, from their file to logs, replays and pages."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from nw_base.errors import SuiteError
from nw_eval import api
from nw_eval.suite import load_suite, suite_yaml
from nw_gate.results.row import rows_digest

ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", Path(__file__).parents[4] / "shared" / "assets"))
SUITE = """\
nw-eval: 1
name: told
robot: go1
policy: stand
trials: 3
seed: 1
episode: {duration: 2.0}
scenes: [open/field]
record: none
"""
VELOCITY = """\
task:
  kind: velocity
  command: {draw: {vx: [0.2, 0.8], yaw: [-0.5, 0.5], every: 0.5}}
  within: {linear: 0.1, angular: 0.2}
scores: [tracking_error_linear]
"""
PUSH = """\
task:
  kind: push
  draw: {size: [2, 8], at: [0.4, 0.8], every: 0.3, count: 2}
  recovered: {hold: 0.2}
"""
STAND = """\
task: {kind: stand, settle: 0.5}
"""
ROBOTS = {
    "b2": """nw-robot: 1
name: b2
model: {file: b2.xml}
motors: [{joints: "*", kp: 160, kd: 5}]
pose: {"*_thigh_joint": 0.8, "*_calf_joint": -1.5}
""",
    "g1": """nw-robot: 1
name: g1
model: {file: g1_12dof.xml}
motors: [{joints: "*", kp: 100, kd: 2}]
pose: {"*_hip_pitch_joint": -0.1, "*_knee_joint": 0.3, "*_ankle_pitch_joint": -0.2}
""",
}
TASKS = {"velocity": VELOCITY, "push": PUSH, "stand": STAND}
BY_DAY = {("b2", "velocity"), ("g1", "push")}


def own_robot(folder, name):
    """Put a robot of the assets into a folder of its own, with its robot.yaml; return where."""
    robot = shutil.copytree(ASSETS / "robots" / name, folder / name)
    (robot / "robot.yaml").write_text(ROBOTS[name])
    return robot


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def ran(folder, text, *, workers=1, name="run"):
    (folder / "told.yaml").write_text(text)
    return api.run(str(folder / "told.yaml"), out=folder / name, workers=workers)


def messages(log, topic):
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [each for *_, each in reader.iter_decoded_messages(topics=[topic])]


def commands(log):
    return np.array([(m.forward, m.left, m.yaw_rate) for m in messages(log, "/robot/command")])


@pytest.mark.parametrize("kind", TASKS)
def test_a_suite_that_was_read_writes_itself_again(folder, kind):
    path = folder / "told.yaml"
    path.write_text(SUITE + TASKS[kind])
    suite = load_suite(path)
    written = suite_yaml(suite)
    path.write_text(written)
    assert load_suite(path) == suite
    assert load_suite(path).digest == suite.digest
    assert "null" not in str(yaml.safe_load(written)["task"])


def test_another_command_is_another_panel(folder):
    path, digests = folder / "told.yaml", set()
    for text in (VELOCITY, VELOCITY.replace("0.8]", "0.9]"), PUSH, STAND):
        path.write_text(SUITE + text)
        digests.add(load_suite(path).digest)
    assert len(digests) == 4


@pytest.mark.parametrize(
    "kind", ["push", *(pytest.param(k, marks=pytest.mark.nightly) for k in ("velocity", "stand"))]
)
def test_one_worker_and_two_give_the_same_bits_and_so_does_a_replay(folder, kind):
    one = ran(folder, SUITE + TASKS[kind], name="one")
    two = ran(folder, SUITE + TASKS[kind], workers=2, name="two")
    assert rows_digest(one.rows) == rows_digest(two.rows)
    assert len({row.state_digest for row in one.rows}) == 3
    for row in one.rows:
        assert (row.status, row.task_kind, row.waypoints_total) == ("ok", kind, 0)
        for start in (0.0, 1.0):
            assert api.replay(folder / "one" / row.mcap_path, start=start).is_identical


def test_each_trial_is_told_its_own_commands_and_its_log_says_which(folder):
    run = ran(folder, SUITE + VELOCITY)
    told = [commands(folder / "run" / row.mcap_path) for row in run.rows]
    for each in told:
        assert each.shape == (100, 3)
        changes = np.flatnonzero(np.any(np.diff(each, axis=0) != 0.0, axis=1)) + 1
        assert changes.tolist() == [25, 50, 75]
        assert (each[:, 0].min() >= 0.2, each[:, 0].max() <= 0.8) == (True, True)
        assert not each[:, 1].any()
    assert not np.array_equal(told[0], told[1])
    # It stands: its error is about the mean speed that it was asked for.
    for row, each in zip(run.rows, told, strict=True):
        assert row.outcome == "timeout"
        asked = np.hypot(each[:, 0], each[:, 1]).mean()
        assert dict(row.scores)["tracking_error_linear"] == pytest.approx(asked, abs=0.05)


def test_a_speed_that_a_task_commands_is_what_the_policy_reads(folder):
    text = SUITE.replace("stand", "go1-parkour").replace("trials: 3", "trials: 1")
    steps = "task: {kind: velocity, command: {steps: [{at: 0, vx: 0.3}, {at: 1, vx: 0.7}]}}\n"
    run = ran(folder, text + steps)
    log = folder / "run" / run.rows[0].mcap_path
    read = [
        {term.name: list(term.values) for term in each.terms}["speed"]
        for each in messages(log, "/observation/proprio")
    ]
    seen = [speed for (speed,) in read]
    assert seen[:50] == pytest.approx([0.3] * 50)
    assert seen[50:] == pytest.approx([0.7] * 50)


def test_pushes_move_the_robot_as_its_mass_says_and_are_in_the_log(folder):
    text = SUITE.replace("trials: 3", "trials: 1").replace("open/field", "flat/carpet_room")
    push = "task: {kind: push, impulses: [{at: 1.0, size: 6, direction: 1.5708}], lasts: 0.02}\n"
    run = ran(folder, text + push)
    log = folder / "run" / run.rows[0].mcap_path
    said = [each.text for each in messages(log, "/nw/event") if each.kind == "task"]
    assert said[0] == "push 1 of 1: 6.0 N s, +90 degrees from the heading"
    assert said[1].startswith("recovered after ")
    left = [each.linear.y for each in messages(log, "/robot/twist")]
    assert max(map(abs, left[45:51])) < 0.02
    # 6 N s on 13 kg are 0.46 m/s of the whole robot; feet on the ground hold some of it.
    assert 0.2 < left[51] < 0.7


def test_a_report_of_a_task_without_waypoints_speaks_of_none(folder):
    run = ran(folder, SUITE + PUSH)
    page = (run.folder / "report.md").read_text()
    html = (run.folder / "report.html").read_text().partition("</style>")[2]
    assert "Success is what the task push counts: 1 of a completed trial." in page
    for text in (page, html):
        assert "0/0" not in text
        assert "waypoint" not in text
        assert "recovery_time" in text
    assert "From above" in html
    assert html.count('class="p o-') == 3, "a path for each trial"
    assert "The log of" not in html


def test_what_does_not_fit_the_policy_is_reported_at_its_line(folder):
    text = SUITE.replace("stand", "go1-parkour") + VELOCITY
    with pytest.raises(SuiteError) as caught:
        ran(folder, text)
    assert str(caught.value) == (
        f"{folder}/told.yaml:12:3: task.command: the policy does not observe yaw: its card has no "
        "term `command`, its speed is the forward one, it turns towards waypoints; give velocity "
        "a policy that follows velocity commands, or give only commands that this one observes"
    )
    late = SUITE + PUSH.replace("[0.4, 0.8]", "[0.4, 1.8]")
    with pytest.raises(SuiteError, match=r"told\.yaml:12:3: task\.draw: the last push may begin"):
        ran(folder, late)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("kind: velocity\n  comand: {constant: {}}", "12:3: unknown key 'comand'; did you mean "),
        ("kind: velocity", "10:1: task: 'command' is missing"),
        ("kind: velocity\n  command: {constant: {vx: 9}}", "12:24: task.command.constant.vx: "),
        ("kind: velocity\n  command: {draw: {vx: [1, 0]}}", "12:13: task.command.draw: vx 1 to 0"),
        ("kind: push\n  impulses: [{at: 1, size: no}]", "12:22: task.impulses.0.size: "),
    ],
)
def test_a_mistake_is_reported_with_line_and_column(folder, wrong, said):
    path = folder / "told.yaml"
    path.write_text(f"{SUITE}task:\n  {wrong}\n")
    with pytest.raises(SuiteError) as caught:
        api.plan(str(path))
    assert f"told.yaml:{said}" in str(caught.value)


@pytest.mark.skipif(not ASSETS.is_dir(), reason="third-party policies are not here")
def test_a_policy_of_somebody_else_follows_a_command_forward_sideways_and_round(folder):
    card = Path(__file__).parents[3] / "policies" / "examples" / "playground-go1"
    text = SUITE.replace("policy: stand", f"policy: {card}").replace("trials: 3", "trials: 1")
    text = text.replace("duration: 2.0", "duration: 6.0")
    steps = "{at: 0, vx: 0.5}, {at: 2, vy: 0.4}, {at: 4, yaw: 0.8}"
    (folder / "told.yaml").write_text(
        f"{text}task: {{kind: velocity, command: {{steps: [{steps}]}}}}\n"
    )
    weights = ASSETS / "policies" / "playground-go1" / "go1_policy.onnx"
    run = api.run("told.yaml", checkpoint=weights, out=folder / "run", workers=1)
    (row,) = run.rows
    assert (row.outcome, row.success) == ("completed", 1.0)
    twist = messages(folder / "run" / row.mcap_path, "/robot/twist")
    found = np.array([(t.linear.x, t.linear.y, t.angular.z) for t in twist])
    for second, asked in ((2, (0.5, 0.0, 0.0)), (4, (0.0, 0.4, 0.0)), (6, (0.0, 0.0, 0.8))):
        np.testing.assert_allclose(found[50 * second - 50 : 50 * second].mean(0), asked, atol=0.3)


@pytest.mark.skipif(not ASSETS.is_dir(), reason="third-party robots are not here")
@pytest.mark.parametrize(
    ("robot", "policy", "kind"),
    [
        # By day one task each.
        pytest.param(
            *robot,
            kind,
            marks=() if (robot[0], kind) in BY_DAY else pytest.mark.nightly,
        )
        for robot in (("b2", "b2-robot-lab"), ("g1", "g1-unitree-rl-gym"))
        for kind in TASKS
    ],
)
def test_any_robot_does_every_task(folder, robot, policy, kind):
    text = SUITE.replace("robot: go1", f"robot: {own_robot(folder, robot)}")
    text = text.replace("trials: 3", "trials: 1")
    text = text.replace("policy: stand", f"policy: {ASSETS / 'policies' / policy}")
    run = ran(folder, text + TASKS[kind].replace("[2, 8]", "[4, 8]"))
    (row,) = run.rows
    assert (row.status, row.task_kind) == ("ok", kind)
    assert row.outcome in {"completed", "timeout"}
    assert api.replay(folder / "run" / row.mcap_path).is_identical


HELD = """\
nw-policy: 1
name: held
robot: go1
adapter: zero
control: {action: joint_position_offset, scale: 0.25, kp: 60, held: [FR_hip]}
observations:
  body: {sensor: proprio, terms: [joint_pos, {term: target, of: {height: 0.27}}]}
"""
TARGETS = """\
task:
  kind: velocity
  command: {constant: {vx: 0.0}}
  targets: {of: {FR_hip: [-0.1, 0.1], height: 0.27}, every: 1.0, over: 0.5}
  within: {linear: 0.2, angular: 0.3, height: 0.05, joints: 0.1}
"""


@pytest.fixture
def asked(folder):
    """A run of a policy that holds a joint which its suite moves."""
    (folder / "held").mkdir()
    (folder / "held" / "policy.yaml").write_text(HELD)
    text = SUITE.replace("policy: stand", "policy: ./held").replace("record: none", "record: all")
    return ran(folder, text + TARGETS)


def test_a_joint_that_is_held_goes_where_the_suite_asks_and_is_measured(asked):
    assert {row.outcome for row in asked.rows} == {"completed"}
    log = next(asked.folder.rglob("*.mcap"))
    told = np.array([m.targets for m in messages(log, "/nw/policy")])
    hip, others = told[:, 0], np.delete(told, 0, axis=1)
    assert np.ptp(hip) > 0.01
    assert np.ptp(others, axis=0) == pytest.approx(0.0)
    assert np.abs(hip).max() <= 0.1 + 1e-9


@pytest.mark.parametrize("follower", ["./held", "stand"])
def test_another_policy_takes_over_whatever_joints_are_held(asked, follower):
    log = next(asked.folder.rglob("*.mcap"))
    found = api.take_over(log, start=1.0, policy=follower)
    assert found.now.end == "completed"
    assert found.was.end == "completed"
