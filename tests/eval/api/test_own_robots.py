"""A robot of one's own in a run: found, fenced, named in rows, sent to nodes, replayed."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from nw_base.errors import PolicyError, RobotError, SuiteError
from nw_eval import api
from nw_eval.engine import ray_file_bundles
from nw_eval.engine.listener import NullListener
from nw_eval.engine.ray_file_bundles import Outgoing
from nw_gate.results.row import rows_digest
from nw_scenes.robots import find_robot

ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", Path(__file__).parents[4] / "shared" / "assets"))

LEG = """<body name="leg_{0}" pos="{1} {2} 0"><joint name="hip_{0}" axis="0 1 0" range="-40 40"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body>"""
PLACES = (("fr", 0.2, -0.12), ("fl", 0.2, 0.12), ("rr", -0.2, -0.12), ("rl", -0.2, 0.12))
MJCF = f"""<mujoco><worldbody><body name="top" pos="0 0 0.4"><freejoint/>
<geom type="box" size="0.25 0.15 0.03" mass="6"/>
{"".join(LEG.format(*place) for place in PLACES)}
</body></worldbody></mujoco>"""
ROBOT = """nw-robot: 1
name: table
model: {file: robot.xml}
motors: [{joints: "*", kp: 60, kd: 2, torque: 30}]
"""
CARD = """nw-policy: 1
name: holds
robot: table
adapter: zero
control: {action: joint_position_offset, scale: 0.25}
observations:
  obs: {sensor: proprio, terms: [joint_pos, {term: foot_contacts, feet: [leg_rl, leg_fr]}]}
"""
SUITE = """nw-eval: 1
name: mine
robot: ./table
policy: ./holds
trials: 1
seed: 3
episode: {duration: 1.0}
scenes: [flat/carpet_room]
record: none
"""


@pytest.fixture
def mine(tmp_path):
    """A folder with a robot, a policy of it, and a suite of both."""
    (tmp_path / "table").mkdir()
    (tmp_path / "table" / "robot.xml").write_text(MJCF)
    (tmp_path / "table" / "robot.yaml").write_text(ROBOT)
    (tmp_path / "holds").mkdir()
    (tmp_path / "holds" / "policy.yaml").write_text(CARD)
    (tmp_path / "mine.yaml").write_text(SUITE)
    return tmp_path


def test_a_robot_of_a_suites_own_folder_runs_and_repeats_bit_for_bit(mine):
    report = api.run(mine / "mine.yaml", out=mine / "run", workers=1, cache=False)
    (row,) = report.rows
    assert (row.status, row.outcome) == ("ok", "timeout")
    reference = find_robot(f"{mine / 'table'}/").reference
    assert row.robot == reference
    assert report.info.suite["robot"] == reference
    assert api.replay(mine / "run" / row.mcap_path).is_identical
    again = api.run(mine / "mine.yaml", out=mine / "again", in_process=True, cache=False)
    assert rows_digest(again.rows) == rows_digest(report.rows)


def test_another_process_scores_the_log_of_a_robot_that_only_the_log_names(mine):
    api.run(mine / "mine.yaml", out=mine / "run", workers=1, cache=False, record="all")
    (log,) = (mine / "run").glob("mcap/*/*/*.mcap")
    (mine / "elsewhere").mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "nw_eval", "scores", str(log)],
        cwd=mine / "elsewhere", capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert re.search(r"^mean_power +\d", done.stdout, re.MULTILINE)


def test_another_robot_of_the_same_name_has_other_trials(mine):
    before = api.plan(mine / "mine.yaml")
    yaml = mine / "table" / "robot.yaml"
    yaml.write_text(ROBOT.replace("kp: 60", "kp: 61"))
    after = api.plan(mine / "mine.yaml")
    assert before.suite.digest != after.suite.digest
    pinned = mine / "pinned.yaml"
    pinned.write_text(SUITE.replace("./table", before.suite.robot))
    with pytest.raises(RobotError, match="is meant"):
        api.plan(pinned)


def test_a_run_goes_on_with_the_robot_that_it_began_with(mine):
    few = api.run(mine / "mine.yaml", out=mine / "run", workers=1, cache=False)
    many = api.run(mine / "mine.yaml", trials=2, resume=mine / "run", workers=1, cache=False)
    assert few.rows[0] in many.rows
    assert len(many.rows) == 2


def test_faults_of_robot_suite_and_card_are_told_with_their_places(mine):
    (mine / "table" / "robot.yaml").write_text(ROBOT.replace("kp:", "pk:"))
    with pytest.raises(RobotError, match=r"robot\.yaml:4:24: unknown key 'pk'; did you mean 'kp'"):
        api.plan(mine / "mine.yaml")
    (mine / "table" / "robot.yaml").write_text(ROBOT)
    (mine / "holds" / "policy.yaml").write_text(CARD.replace("leg_rl", "leg_lr"))
    message = r"policy\.yaml:7:67: observations\.obs: foot_contacts: the robot has no foot"
    with pytest.raises(PolicyError, match=message):
        api.plan(mine / "mine.yaml")
    (mine / "holds" / "policy.yaml").write_text(CARD.replace("robot: table", "robot: ../table"))
    with pytest.raises(PolicyError, match=r"policy\.yaml:3:1: robot: '\.\./table' is not a name"):
        api.plan(mine / "mine.yaml")
    (mine / "holds" / "policy.yaml").write_text(CARD.replace("robot: table", "robot: go1"))
    with pytest.raises((PolicyError, SuiteError), match="has no foot 'leg_rl'"):
        api.plan(mine / "mine.yaml")


def test_a_node_receives_the_robots_files(mine, monkeypatch):
    plan = api.plan(mine / "mine.yaml")
    outgoing = Outgoing(plan)
    monkeypatch.setenv("NW_EVAL_CACHE", str(mine / "node"))
    ray_file_bundles.receive(
        outgoing.file_bundles, lambda sha256: [outgoing.sources[sha256].read_bytes()]
    )
    there = ray_file_bundles.places(outgoing.file_bundles)[str(plan.robot_folder)]
    assert Path(there).is_relative_to(mine / "node")
    assert find_robot(f"{there}/").reference == plan.suite.robot


B2 = """pose: {"*_thigh_joint": 0.8, "*_calf_joint": -1.5}
motors: [{joints: "*", kp: 160, kd: 5}]
"""
G1 = """pose: {"*_hip_pitch_*": -0.1, "*_knee_*": 0.3, "*_ankle_pitch_*": -0.2}
motors: [{joints: "*", kp: 100, kd: 2}]
fell: {tilt: 1.0, height: 0.45}
"""
PAIRS = {
    "b2": ("b2.xml", "b2-robot-lab", B2, "[flat/carpet_room, ramps/one_ramp_plaza]", 6),
    "g1": ("g1_12dof.xml", "g1-unitree-rl-gym", G1, "[flat/carpet_room]", 3),
}


@pytest.mark.assets
@pytest.mark.parametrize("name", PAIRS)
def test_policies_of_others_walk_on_robots_of_others(tmp_path, name):
    model, policy, extra, scenes, walked = PAIRS[name]
    robot, card = ASSETS / "robots" / name, ASSETS / "policies" / policy
    if not (robot.is_dir() and card.is_dir()):
        pytest.skip(f"needs {robot} and {card}")
    shutil.copytree(robot, tmp_path / name)
    head = f"nw-robot: 1\nname: {name}\nmodel: {{file: {model}}}\n"
    (tmp_path / name / "robot.yaml").write_text(head + extra)
    (tmp_path / "walk.yaml").write_text(
        f"nw-eval: 1\nname: walk\nrobot: ./{name}\npolicy: {card}\ntrials: 3\nseed: 7\n"
        f"scenes: {scenes}\nrecord: none\n"
    )
    report = api.run(tmp_path / "walk.yaml", out=tmp_path / "run", workers=1, cache=False)
    assert [row.outcome for row in report.rows] == ["completed"] * walked


@pytest.mark.parametrize(
    ("control", "steps"),
    [
        pytest.param("rate: 100", 100, marks=pytest.mark.nightly),
        ("rate: 62.5, physics_rate: 250", 62),
        ("rate: 30, physics_rate: 300", 30),
        pytest.param("rate: 25", 50, marks=pytest.mark.nightly),
    ],
)
def test_a_policy_acts_at_its_own_rate_and_its_trial_is_replayed_to_the_bit(mine, control, steps):
    card = CARD.replace("scale: 0.25}", f"scale: 0.25, {control}}}")
    (mine / "holds" / "policy.yaml").write_text(card)
    suite = SUITE.replace("record: none", "record: all") + "perturb: {push: [0.2]}\n"
    (mine / "mine.yaml").write_text(suite)
    result = api.run(suite=mine / "mine.yaml", out=mine / "out", workers=1, cache=False)
    (row,) = result.rows
    assert row.status == "ok"
    assert abs(row.steps - steps) <= 1
    assert row.sim_s == pytest.approx(1.0, abs=0.04)
    (log,) = (mine / "out").rglob("*.mcap")
    assert api.replay(log).is_identical
    assert api.replay(log, start=0.5).is_identical


def test_the_published_protocol_has_control_steps_of_its_own(mine):
    card = CARD.replace("scale: 0.25}", "scale: 0.25, rate: 100}")
    (mine / "holds" / "policy.yaml").write_text(card)
    (mine / "mine.yaml").write_text(SUITE + "protocol: neverwhere-2026\n")
    with pytest.raises(PolicyError, match=r"control.rate is 100, the protocol .* of 0.02 s"):
        api.run(suite=mine / "mine.yaml", out=mine / "out", workers=1)


def test_a_run_says_first_what_no_leg_of_its_robot_could_do(mine):
    said = []

    class Ears(NullListener):
        def message(self, text):
            said.append(text)

    short = MJCF.replace("0 0 -0.3", "0 0 -0.12").replace('pos="0 0 0.4"', 'pos="0 0 0.2"')
    (mine / "table" / "robot.xml").write_text(short)
    scenes = "scenes: [flat/carpet_room, hurdles/one_high_stone_plaza]"
    (mine / "mine.yaml").write_text(SUITE.replace("scenes: [flat/carpet_room]", scenes))
    api.run(suite=mine / "mine.yaml", out=mine / "out", workers=1, cache=False, listener=Ears())
    (line,) = [text for text in said if "legs of table" in text]
    assert "hurdles/one_high_stone_plaza (a step of 0.30 m up, a step of 0.30 m down)" in line
    assert "flat/carpet_room" not in line
