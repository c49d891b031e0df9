import re
import textwrap

import pytest
from pydantic import ValidationError

from nw_base.errors import PolicyError
from nw_base.files.yaml_file import parse_yaml
from nw_policies.cards import JointControl, load_card
from nw_policies.cards.terms import LAYOUTS, Constant, term_size
from nw_scenes.robots import get_robot

MINIMAL = """\
nw-policy: 1
name: mine
robot: go1
adapter: onnx
checkpoint: {file: policy.onnx, sha256: %s}
control: {action: joint_position_offset, scale: 0.25}
observations:
  obs: {sensor: proprio, layout: parkour53}
""" % ("ab" * 32)


NAME_ALL = "name every joint"
GIVE = "give one value, one for each joint, or a mapping by name"


def written_card(folder, text):
    path = folder / "policy.yaml"
    path.write_text(textwrap.dedent(text))
    return path


def problems_of(folder, text):
    with pytest.raises(PolicyError) as caught:
        load_card(written_card(folder, text))
    return str(caught.value).splitlines()


def test_every_fault_of_joints_is_told_at_once_with_its_place(tmp_path):
    text = MINIMAL.replace(
        "control: {action: joint_position_offset, scale: 0.25}",
        """\
control:
  action: joint_position_offset
  scale: {hip: 0.1, thigh: 0.25}
  default_pose: {F_thigh: 0.8, claf: -1.5}
  kp: -35
  kd: {hip: 1, calf: -2}
  torque_limits: [20, 20]""",
    )
    file = tmp_path / "policy.yaml"
    assert problems_of(tmp_path, text) == [
        f"{file}:8:3: control.scale: no value for FR_calf, FL_calf, RR_calf, RL_calf; {NAME_ALL}",
        f"{file}:9:18: control.default_pose: 'F_thigh' names no joint; did you mean 'FR_thigh'?",
        f"{file}:9:32: control.default_pose: 'claf' names no joint; did you mean 'calf'?",
        f"{file}:10:3: control.kp: -35 is negative; give 0 or more",
        f"{file}:11:16: control.kd: -2 is negative; give 0 or more",
        f"{file}:12:3: control.torque_limits: 2 values for 12 joints; {GIVE}",
    ]


def test_a_wrong_order_of_joints_does_not_hide_other_faults(tmp_path):
    control = "control: {action: joint_position_offset, joints: [FL_hip, FL_hip], kd: -1}"
    text = MINIMAL.replace("control: {action: joint_position_offset, scale: 0.25}", control)
    order, negative = problems_of(tmp_path, text)
    assert "control.joints: joint 'FL_hip' is named twice" in order
    assert "control.kd: -1 is negative" in negative


@pytest.mark.parametrize("slip", ["true", '"35"', "{hip: true}", "[true]"])
def test_what_is_no_number_is_no_gain(tmp_path, slip):
    text = MINIMAL.replace("scale: 0.25", f"scale: 0.25, kp: {slip}")
    (problem,) = problems_of(tmp_path, text)
    assert ":6:" in problem
    assert "control.kp" in problem
    assert "number" in problem


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("scale: {FR_hip: 0.3, hip: 0.5, thigh: 1, calf: 1}", [0.3, 1, 1, 0.5]),
        ("scale: {FR_hip: 0.3, F*_hip: 0.4, hip: 0.5, thigh: 1, calf: 1}", [0.3, 1, 1, 0.4]),
        ("scale: {hip: 0.5, thigh: 1, calf: 1, F*: 2}", [2, 2, 2, 2]),
    ],
)
def test_the_more_exact_key_of_a_mapping_counts(tmp_path, written, meant):
    card = load_card(written_card(tmp_path, MINIMAL.replace("scale: 0.25", written)))
    scale = JointControl.from_card(card, get_robot("go1")).scale
    assert scale[:4].tolist() == meant


@pytest.mark.parametrize(
    ("pose", "fault"),
    [
        ("{thigh: 51}", "51 is beyond the range of FR_thigh; give radians from -1.0472 to 4.18879"),
        ("{calf: 1.8}", "1.8 is beyond the range of FR_calf"),
        ("[-5.7, 0.8, -1.5, 0, 0.8, -1.5, 0, 0.8, -1.5, 0, 0.8, -1.5]", "-5.7 is beyond the range"),
        ("0.0", "0 is beyond the range of FR_calf"),
    ],
)
def test_a_default_pose_that_no_joint_can_take_is_refused(tmp_path, pose, fault):
    text = MINIMAL.replace("scale: 0.25", f"scale: 0.25, default_pose: {pose}")
    (problem,) = problems_of(tmp_path, text)
    assert f"control.default_pose: {fault}" in problem


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "name: mine",
            "name: My Policy",
            ":2:1: name: 'My Policy' is not a valid policy name; use",
        ),
        (
            "ab" * 32,
            "ab" * 20,
            "is not a SHA-256, which has 64 hex digits, not 40; `sha256sum FILE`",
        ),
        ("scale: 0.25", 'scale: "0.5"', "should be a mapping, got '0.5'"),
        ("scale: 0.25", "stiffness: 20", "unknown key 'stiffness'; here it is 'kp'"),
        ("scale: 0.25", "latency: 0.02", "unknown key 'latency'; here it is 'delay_steps'"),
        ("scale: 0.25", "clip: [1, 2, 3]", "control.clip: has 3 values, at most 2 fit"),
        ("joint_position_offset", "joint_torque, kp: 20", ":6:33: control.kp: kp has no meaning"),
        ("robot: go1", "robot:\tgo1\n\tx: 1", "a tab stands here; use spaces"),
    ],
)
def test_slips_are_told_in_plain_words(tmp_path, old, new, said):
    problem, *_ = problems_of(tmp_path, MINIMAL.replace(old, new))
    assert said in problem
    assert problem.count("got ") <= 1


def test_a_digest_may_be_written_in_upper_case(tmp_path):
    card = load_card(written_card(tmp_path, MINIMAL.replace("ab" * 32, "AB" * 32)))
    assert card.checkpoint.sha256 == "ab" * 32


def test_a_robot_that_nobody_knows_is_told_with_its_place(tmp_path):
    (problem,) = problems_of(tmp_path, MINIMAL.replace("robot: go1", "robot: go3"))
    assert ":3:1: robot: unknown robot 'go3'; did you mean 'go" in problem


def test_a_camera_that_the_robot_does_not_have_is_told_with_its_place(tmp_path):
    card = MINIMAL + "  eye: {sensor: depth, camera: eggo}\ncameras: {realsens: {pitch: 0.1}}\n"
    seen, mounted = problems_of(tmp_path, card)
    assert ":9:24: observations.eye.camera: go1 has no camera 'eggo'; did you mean 'ego'?" in seen
    assert ":10:11: cameras.realsens: go1 has no camera 'realsens'; did you mean" in mounted


def test_a_card_of_eight_lines_is_enough(tmp_path):
    card = load_card(written_card(tmp_path, MINIMAL))
    assert card.control.delay_steps == 0
    assert card.control.clip is None
    assert card.observations["obs"].rate == 50


def test_all_problems_of_a_card_are_said_at_once_with_their_lines(tmp_path):
    text = MINIMAL.replace("robot: go1", "robto: go1").replace("scale: 0.25", "scale: fast")
    text = text.replace("layout: parkour53", "layout: parkour35")
    problems = problems_of(tmp_path, text)
    assert [line.split(":")[1] for line in problems] == ["1", "3", "6", "8"]
    assert "'robot' is missing" in problems[0]
    assert "unknown key 'robto'; did you mean 'robot'?" in problems[1]
    assert "control.scale" in problems[2]
    assert "'fast'" in problems[2]
    assert "'parkour35' is not one of them" in problems[3]


def test_an_unknown_key_of_a_sensor_names_the_nearest_one_of_that_sensor(tmp_path):
    text = MINIMAL + "  eye: {sensor: splat_rgb, widht: 80}\n"
    assert "did you mean 'width'?" in problems_of(tmp_path, text)[0]


def test_duplicate_keys_are_refused(tmp_path):
    problems = problems_of(tmp_path, MINIMAL + "name: other\n")
    assert problems[0].endswith("9:1: duplicate key 'name', first on line 2; keep one of them")


def test_yaml_tags_make_no_objects(tmp_path):
    problems = problems_of(tmp_path, MINIMAL + "title: !!python/object/apply:os.getcwd []\n")
    assert "has the tag 'os.getcwd'" in problems[0]


def test_nested_aliases_are_refused_before_they_fill_the_memory(tmp_path):
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    assert "too many values" in problems_of(tmp_path, "\n".join(lines))[0]


def test_a_missing_card_is_one_line(tmp_path):
    with pytest.raises(PolicyError, match="cannot be read") as caught:
        load_card(tmp_path / "policy.yaml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            "  eye: {sensor: splat_rgb, rate: 15}",
            "sampled at 15 Hz, the policy acts at 50 Hz; give a rate that divides it",
        ),
        ("  eye: {sensor: splat_rgb, latency: 0.03}", "whole number of control steps"),
        ("  eye: {sensor: splat_rgb, sampling: published, width: 160}", "makes 80 x 45"),
        ("  dots: {sensor: scandots, clip: [1, -1]}", "are empty"),
        ("  body: {sensor: proprio}", "needs `layout` or `terms`"),
        ("  body: {sensor: proprio, terms: [comand]}", "'comand' is not known"),
        ("  body: {sensor: proprio, terms: [command]}", "add `command: {source: trail_follower}`"),
        (
            "  body: {sensor: proprio, terms: [{term: last_output, clipped: true}]}",
            "'body' feeds a clipped action back but the card clips none; add `clip` to `control`",
        ),
        ("  dots: {sensor: scandts}", "did you mean 'scandots'?"),
        ("inputs: {obs: [obss]}", "unknown observation 'obss'; did you mean 'obs'?"),
        ("inputs: {obs: []}", "has no observations"),
        (
            "command: {source: trail_follower, speed: 0.3, least_speed: 0.4}",
            "least_speed, 0.4 m/s, is more than speed, 0.3 m/s",
        ),
    ],
)
def test_values_that_make_no_sense_are_said_with_what_would(tmp_path, line, said):
    assert said in "\n".join(problems_of(tmp_path, MINIMAL + line + "\n"))


def test_an_observation_that_no_input_uses_is_an_error(tmp_path):
    text = MINIMAL + "  dots: {sensor: scandots}\ninputs: {obs: [obs]}\n"
    assert "no input uses the observation dots" in problems_of(tmp_path, text)[0]


@pytest.mark.parametrize("file", ["../policy.onnx", "/etc/passwd", "a/../../b.onnx"])
def test_a_checkpoint_outside_the_folder_is_refused(tmp_path, file):
    problems = problems_of(tmp_path, MINIMAL.replace("policy.onnx", file))
    assert "leaves the card's folder" in problems[0]


def test_a_clip_of_one_number_limits_both_sides(tmp_path):
    text = MINIMAL.replace("scale: 0.25", "scale: 0.25, clip: 4.8")
    assert load_card(written_card(tmp_path, text)).control.clip == (-4.8, 4.8)


def test_parkour53_has_53_numbers():
    assert sum(term_size(term, get_robot("go1").joints) for term in LAYOUTS["parkour53"]) == 53


def test_a_slow_policys_observations_take_its_rate_unless_they_say_another(tmp_path):
    text = MINIMAL.replace("scale: 0.25}", "scale: 0.25, rate: 25}")
    text += "  rgb: {sensor: splat_rgb, camera: ego, width: 8, height: 8, rate: 5}\n"
    card = load_card(written_card(tmp_path, text))
    assert card.control.hold == 2
    assert card.observations["obs"].rate == 25
    assert card.observations["rgb"].rate == 5


@pytest.mark.parametrize(
    ("control", "words"),
    [
        (
            "rate: 30",
            "6.667 for an action of 0.03333 s; use `physics_rate: 210 or 240 or 270`, or `rate: 28",
        ),
        ("rate: 62.5", "use `physics_rate: 250 or 375 or 500`, or `rate: 50 or 66.6667`"),
        ("rate: 400", "use `physics_rate: 400 or 800 or 1200`"),
        ("rate: 0.5", "must be at least 1"),
        ("physics_rate: 240", "240 physics steps a second are 4.8 for a control step of 0.02 s"),
        ("action: joint_torque, kp: 20", "kp has no meaning for torques"),
    ],
)
def test_rates_and_gains_that_mean_nothing_are_refused_with_the_reason(tmp_path, control, words):
    text = MINIMAL.replace(
        "action: joint_position_offset, ",
        "" if "action" in control else "action: joint_position_offset, ",
    )
    text = text.replace("scale: 0.25}", f"scale: 0.25, {control}}}")
    assert words in problems_of(tmp_path, text)[0]


def test_an_observation_faster_than_its_policy_is_refused(tmp_path):
    text = MINIMAL.replace("scale: 0.25}", "scale: 0.25, rate: 25}")
    text = text.replace("layout: parkour53}", "layout: parkour53, rate: 50}")
    assert "'obs' is sampled at 50 Hz, the policy acts at 25 Hz" in problems_of(tmp_path, text)[0]


def test_an_input_is_either_observed_or_recurrent(tmp_path):
    text = MINIMAL + "inputs: {obs: [obs]}\nrecurrent: {obs: out}\n"
    assert "'obs' is in `recurrent` too" in problems_of(tmp_path, text)[0]


@pytest.mark.parametrize(
    ("adapter", "recurrent", "said"),
    [
        ("torch-export", "h_out", "`torch-export` keeps its state itself; remove it"),
        ("torchscript", "h_out", "have no names, .* write `recurrent: {h: {output: 1, shape:"),
        ("onnx", "{output: 1, shape: [1, 2]}", "has names for its outputs; write `recurrent: {in"),
    ],
)
def test_what_is_fed_back_is_said_as_the_file_names_it(tmp_path, adapter, recurrent, said):
    text = MINIMAL.replace("adapter: onnx", f"adapter: {adapter}")
    assert re.search(said, problems_of(tmp_path, f"{text}recurrent: {{h: {recurrent}}}\n")[0])


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        (
            "{?L_hip: 0.1}",
            r'begins with `\?` is read by YAML as \'L_hip\'; put it in quotes: "\?L_hip"',
        ),
        ("{*_hip: 0.1}", r'found undefined alias .*begins with `\*` in quotes: "\*_hip"'),
    ],
)
def test_a_pattern_that_yaml_reads_as_its_own_sign_is_to_be_quoted(scale, said):
    with pytest.raises(ValueError, match=said):
        parse_yaml(f"control: {{scale: {scale}}}", file="policy.yaml")
    quoted = re.sub(r"{(.*?):", r'{"\1":', scale)
    read = parse_yaml(f"control: {{scale: {quoted}}}", file="policy.yaml")
    assert list(read.data["control"]["scale"].values()) == [0.1]


def test_many_equal_constants_are_said_in_short_and_are_the_same_card():
    short = Constant.model_validate({"term": "constant", "value": 0.5, "width": 187})
    long = Constant.model_validate({"term": "constant", "values": [0.5] * 187})
    assert short == long
    assert short.model_dump(mode="json") == long.model_dump(mode="json")
    assert term_size(short, ()) == 187


@pytest.mark.parametrize(
    "given", [{}, {"value": 0}, {"width": 3}, {"values": [1.0], "width": 3}, {"values": []}]
)
def test_a_constant_has_one_of_its_two_forms(given):
    with pytest.raises(ValidationError, match=r"`values: .*`, or `value` and `width`"):
        Constant.model_validate({"term": "constant"} | given)
