"""Each field of a file beside a checkpoint is used, passed over with a reason, or named.

Every value of a file is marked, one at a time; the mark is found in exactly one of these.
"""

import copy
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from nw_base.errors import PolicyError
from nw_base.files.yaml_file import parse_yaml
from nw_policies.drafting.beside import believed, read_beside, refuse_another_robot
from nw_policies.drafting.checkpoint import CheckpointFacts
from nw_policies.drafting.configs import reader_of
from nw_policies.drafting.exporters import ExporterMetadata, read_exporter_metadata
from nw_policies.drafting.fields import Fields, account, is_passed_over
from nw_policies.drafting.leapp import read_pipeline
from nw_scenes.robots import get_robot

from .test_beside import (
    BY_TYPE,
    DEPLOY,
    DESCRIPTORS,
    ENVIRONMENT,
    GO2_DEPLOY,
    GYM,
    LEGGED,
    MUWANX,
    ROS2,
    SAR,
)

ROS = ROS2 % (
    ", ".join(f"{joint}_joint" for joint in BY_TYPE),
    ", ".join(
        f"{joint}_joint: {{scale: 0.25, kp: 25, kd: 0.5, default_pos: 0.1}}" for joint in BY_TYPE
    ),
)
AGENT = """
seed: 42
policy: {class_name: ActorCritic, activation: elu, actor_hidden_dims: [512], init_noise_std: 1.0}
algorithm: {gamma: 0.99}
clip_actions: 4.0
"""
FILES = {
    "deploy": DEPLOY,
    "io_descriptors": json.dumps(DESCRIPTORS),
    "env": ENVIRONMENT,
    "agent": AGENT,
    "legged_rl_deploy": LEGGED,
    "rl_sar": SAR,
    "gym": GYM,
    "gym, go2_deploy": GO2_DEPLOY,
    "legged_ros2": ROS,
    "muwanx": json.dumps(MUWANX),
}
ROBOT = get_robot("go2")


def leaves(value, path=()):
    """Give the paths of all values that are no mappings."""
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from leaves(item, (*path, key))
    elif isinstance(value, list) and any(isinstance(item, dict) for item in value):
        for place, item in enumerate(value):
            yield from leaves(item, (*path, place))
    elif value not in (None, "", [], {}, False):
        yield path


def changed(data, path, value):
    data = copy.deepcopy(data)
    inner = data
    for part in path[:-1]:
        inner = inner[part]
    inner[path[-1]] = value
    return data


def read(data):
    """Return what the reader of a file says, and the sentences of its account."""
    kind, reader = reader_of(Fields(data))
    fields = Fields(data)
    said = reader(fields, ROBOT, [fields])
    return kind, said, account("f.yaml", [kind], fields), fields


def passed_over(kind, path):
    return any(is_passed_over(".".join(map(str, path)), which) for which in ("", kind))


@pytest.mark.parametrize("name", FILES)
def test_each_field_of_a_file_is_read_or_passed_over_or_named(name):
    data = parse_yaml(FILES[name], file="f.yaml", foreign=True).data
    kind, _, notes, fields = read(data)
    assert kind == name.partition(",")[0]
    unread = {path for path, _, _ in fields.unread()}
    counted = 0
    for path in leaves(data):
        mark = ".".join(map(str, path))
        named = any(re.search(rf"(^|[ :]){re.escape(mark)}(,|$| cannot)", note) for note in notes)
        was_read = mark not in unread
        ways = [was_read, not was_read and passed_over(kind, path), named and not was_read]
        assert sum(ways) == 1, (mark, ways, notes)
        counted += 1
    assert counted > 3


@pytest.mark.parametrize("name", FILES)
def test_a_field_that_no_reader_knows_is_named_wherever_it_stands(name):
    data = parse_yaml(FILES[name], file="f.yaml", foreign=True).data
    kind = name.partition(",")[0]
    named = 0
    for path in {(), *(path[:-1] for path in leaves(data))}:
        marked = (*path, "zz_mark")
        if any(isinstance(part, str) and "." in part for part in path):
            continue
        _, _, notes, _ = read(changed(data, marked, 7.25))
        passed = passed_over(kind, marked)
        assert ("zz_mark" in " ".join(notes)) != passed, (marked, notes)
        named += not passed
    assert named or kind in {"agent", "legged_ros2"}


@pytest.mark.parametrize("odd", [math.nan, math.inf, "soon", [1.0, math.nan], {"a": "b"}])
@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("deploy", ("stiffness",)),
        ("deploy", ("step_dt",)),
        ("deploy", ("observations", "base_ang_vel", "scale")),
        ("env", ("scene", "robot", "actuators", "legs", "damping")),
        ("env", ("decimation",)),
        ("gym", ("kps",)),
        ("gym", ("action_scale",)),
        ("rl_sar", ("go2/himloco", "rl_kp")),
        ("legged_rl_deploy", ("policy", "damping")),
        ("muwanx", ("stiffness",)),
    ],
)
def test_a_number_that_cannot_be_read_is_named_with_its_key(name, path, odd):
    data = parse_yaml(FILES[name], file="f.yaml", foreign=True).data
    if path[0] not in data:
        path = (next(iter(data)), *path[1:])
    _, said, notes, _ = read(changed(data, path, odd))
    assert any(f"{'.'.join(path)}" in note and "cannot be read" in note for note in notes), notes
    assert "nan" not in repr(said).lower()


def of_texts(texts, checkpoint="policy.onnx", own=None, size=0):
    known = read_beside(texts, ROBOT, checkpoint, own, size)
    assert known is not None
    return known


WTW = GO2_DEPLOY.replace("num_single_obs: 45", "num_single_obs: 61\ntheta_fl: [0.0, 0.5]")


def test_a_config_with_one_unknown_term_keeps_what_is_known_and_names_it():
    known = of_texts({"wtw_config.yaml": WTW}, size=305)
    assert (known.joint_stiffness, known.joint_damping, known.rate) == ((20,), (0.5,), 50)
    names = [term.name for term in known.observation_terms]
    assert names == ["commands", "projected_gravity", "ang_vel", "dof_pos", "dof_vel", "actions",
                     "what_the_script_adds"]  # fmt: skip
    assert known.observation_terms[-1].width == 16
    assert "wtw_config.yaml has what this card does not: theta_fl" in known.notes
    assert "61 numbers names no terms" in " ".join(known.notes)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("common: {rate: 3}\nnormalization: {clip: 5}", "its keys are common, normalization"),
        ("kps: [", "is not YAML"),
    ],
)
def test_a_file_of_no_known_kind_is_named(text, said):
    (note,) = of_texts({"T1.yaml": text}).notes
    assert note.startswith("T1.yaml was not read: ")
    assert said in note


def test_files_of_another_policy_are_named():
    other = GO2_DEPLOY.replace("num_single_obs: 45", "num_single_obs: 48")
    known = of_texts({"a.yaml": other, "b.yaml": GO2_DEPLOY}, size=225)
    assert "not read, of another policy by names or sizes: a.yaml" in known.notes


def test_of_two_files_that_differ_both_are_named():
    env = ENVIRONMENT.replace("damping: 0.5", "damping: 0.9")
    known = of_texts({"deploy.yaml": DEPLOY, "env.yaml": env}, size=105)
    assert "joint_damping differs in deploy.yaml and env.yaml: the first is used" in known.notes
    assert not any("armature differs" in note for note in known.notes)


BASE = {
    "joint_names": ",".join(f"robot/{joint}_joint" for joint in BY_TYPE),
    "joint_stiffness": ",".join(["20.000"] * 12),
    "joint_damping": ",".join(["1.000"] * 12),
    "default_joint_pos": ",".join(["0.100"] * 4 + ["0.900"] * 4 + ["-1.800"] * 4),
    "action_scale": ",".join(["0.250"] * 12),
    "observation_names": "base_ang_vel,joint_pos",
    "observation_terms_scale": "0.250,1.000",
    "observation_terms_clip": "None,None",
    "observation_terms_history_length": "0,0",
    "observation_terms_flatten_history_dim": "True,True",
    "command_names": "twist",
    "run_path": "none",
}


def metadata(**changes):
    known = read_exporter_metadata({**BASE, **changes})
    assert known is not None
    return believed(known, ROBOT)


def test_metadata_of_an_exporter_leaves_nothing_to_say():
    known = metadata()
    assert known.notes == ()
    assert known.joint_names[0] == "FL_hip_joint", "the name of the entity is taken off"
    assert known.joint_stiffness == (20.0,) * 12


@pytest.mark.parametrize(
    ("changes", "field", "said"),
    [
        ({"joint_stiffness": ",".join(["20.000"] * 11)}, "joint_stiffness", "11 numbers for 12"),
        ({"joint_stiffness": ",".join(["1.000"] * 12)}, "joint_stiffness", "1 N m/rad at most"),
        ({"joint_damping": ",".join(["-0.000"] * 12)}, "joint_damping", "is 0 for all joints"),
        ({"joint_damping": "-1.000"}, "joint_damping", "is -1, below 0"),
        ({"action_scale": "0.000"}, "action_scale", "is 0 for all joints"),
        ({"default_joint_pos": "nan"}, "default_joint_pos", "cannot be read: nan"),
        ({"action_scale": "{'.*': 0.25}"}, "action_scale", "cannot be read: {'.*': 0.25}"),
        ({"observation_terms_scale": "1,2,3"}, "", "terms_scale in its metadata has not"),
        ({"observation_terms_scale": "0.000,1.000"}, "", "the scale of base_ang_vel is 0"),
        ({"command_names": "grasp"}, "", "does not: command_names"),
        ({"zz_mark": "1"}, "", "does not: zz_mark"),
        ({"joint_damping": "0.004"}, "", "joint_damping of its metadata has 0.004, which three"),
    ],
)  # fmt: skip
def test_metadata_that_cannot_be_a_robots_is_not_used_and_named(changes, field, said):
    known = metadata(**changes)
    assert said in " ".join(known.notes)
    assert not field or getattr(known, field) == ()


def test_each_entry_of_exploys_metadata_is_used_or_named():
    entries = {
        "exploy_version": "0.1",
        "update_rate": "25.0",
        "output.joint_targets.legs": json.dumps(
            {"names": BY_TYPE, "stiffness": [20.0] * 12, "damping": "x", "zz_mark": 1}
        ),
        "output.joint_targets.arms": "{}",
        "cmd.se2_velocity.vel": json.dumps({"ranges": {"lin_vel_x": [-0.5, 0.5], "zz_b": 2}}),
    }
    known = read_exporter_metadata(entries)
    said = " ".join(known.notes)
    for name in ("zz_mark", "zz_b", "output.joint_targets.arms", "damping cannot be read: x"):
        assert said.count(name) == 1
    assert (known.rate, known.joint_stiffness) == (25, (20.0,) * 12)


LEAPP = sorted((Path(__file__).parent / "leapp").glob("*/*.yaml"))


@pytest.mark.parametrize("path", LEAPP, ids=lambda path: path.parent.name)
def test_a_pipeline_has_nothing_unread_but_a_mark(path):
    text = path.read_text()
    assert read_pipeline(text, path.name).notes == ()
    (note,) = read_pipeline(f"{text}\nzz_mark: 3\n", path.name).notes
    assert note.endswith("has what this card does not: zz_mark")
    (note,) = read_pipeline(text.replace("frequency: 50", "frequency: 1e9"), path.name).notes
    assert "pipeline.configs.frequency cannot be read" in note


def test_gains_of_torques_may_be_zero():
    known = ExporterMetadata(action="joint_torque", joint_damping=(0.0,) * 12)
    assert believed(known, ROBOT) == known
    assert believed(replace(known, action=""), ROBOT).joint_damping == ()


def test_joints_that_were_guessed_do_not_make_another_robot_look_like_ours():
    known = ExporterMetadata(joint_names=tuple(BY_TYPE), guessed_order=True, joint_count=10)
    facts = CheckpointFacts(path=Path("h1.pt"), sha256="", format="torchscript", adapter=None)
    with pytest.raises(PolicyError, match="about 10 joints") as raised:
        refuse_another_robot(facts, known, ROBOT)
    assert "looks like" not in str(raised.value)
