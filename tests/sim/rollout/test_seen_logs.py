"""What the policy was given, where it walked and what it was asked for, read back from logs."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from nw_eval.viewing.shown import layout_json, shown_by_card, shown_in_log
from nw_gate.scores.own import Expectation, expectation_text
from nw_policies import load_bundle
from nw_policies.cards.observations import ProprioObservation
from nw_scenes.robots import get_robot
from nw_sim.rollout.episode import Episode
from nw_sim.rollout.job import StageClock
from nw_sim.rollout.mcap.drawn import cloud_points
from nw_sim.rollout.mcap.images import observation_digest
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.mcap.topics import TOPICS
from nw_sim.rollout.observed import MANY, element_names
from nw_sim.rollout.opening import open_trial
from nw_sim.rollout.trial import run_trial
from nw_sim.sensors.drawing.pictures import PALETTE

CARD = """\
nw-policy: 1
name: watches
robot: go1
adapter: zero
control: {action: joint_position_offset, scale: 0.25, delay_steps: 1}
command: {source: trail_follower, speed: 0.7}
cameras: {ego: {readout: 0.02, exposure: 0.01}}
observations:
  body: {sensor: proprio, terms: [gravity, command, joint_pos], noise: {gaussian: 0.01}}
  past: {sensor: proprio, layout: parkour53, history: {steps: 3}, rate: 25, latency: 0.04}
  map: {sensor: heightmap, rate: 10}
  rays: {sensor: lidar, channels: 4, columns: 400, rate: 10}
  photo: {sensor: splat_rgb, width: 40, height: 24, rate: 10, dtype: float32, axes: chw, stack: 2}
  grey: {sensor: splat_rgb, width: 40, height: 24, rate: 10, wrap: [grayscale]}
  metres: {sensor: depth, width: 40, height: 24, rate: 10, latency: 0.04, noise: {gaussian: 0.02}}
  near: {sensor: depth, width: 40, height: 24, rate: 10, mode: linear, wrap: [
    {wrapper: crop, top: 4}, {wrapper: resize, width: 20, height: 10}, {wrapper: stack, steps: 3}]}
  classes: {sensor: semantics, width: 40, height: 24, rate: 10}
  drawing: {sensor: semantics, width: 40, height: 24, rate: 10, values: colors}
  row: {sensor: depth, width: 40, height: 24, rate: 10, wrap: [flatten]}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("watches")
    (folder / "policy.yaml").write_text(CARD)
    return folder


@pytest.fixture(scope="module")
def watched(folder, make_job, library, tmp_path_factory):
    """Return the log of a second, and what the policy was given: by name, (time, array) of each."""
    given = {}
    ask = Episode._ask

    def listening(self, observation):
        for name, array in observation.items():
            if self.sensors[name].fresh:
                given.setdefault(name, []).append((self.world.time, array.copy()))
        return ask(self, observation)

    path = tmp_path_factory.mktemp("log") / "watched.mcap"
    job = make_job(policy=str(folder), mcap=path, record="all", duration=1.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Episode, "_ask", listening)
        result = run_trial(job, library=library)
    assert (result.status, result.mcap_error) == ("ok", "")
    return LogReader(path), given


SCORES = (
    "mean_power",
    "time_to_finish",
    expectation_text("slow", Expectation(reading="joint_rate", at_most=3.0)),
    expectation_text("on_time", Expectation(score="time_to_finish", at_most=6.0)),
)


@pytest.fixture(scope="module")
def walked(make_job, library, tmp_path_factory):
    """Return the log of two seconds of the shipped policy, and its job."""
    path = tmp_path_factory.mktemp("log") / "walked.mcap"
    job = make_job(mcap=path, record="all", scores=SCORES)
    run_trial(job, library=library)
    return LogReader(job.mcap), job


def pairs(read, given):
    """Yield (logged, given) at the same times."""
    read = list(read)
    assert [time for time, _ in read] == pytest.approx([time for time, _ in given])
    assert len(read) > 1
    return [(array, expected) for (_, array), (_, expected) in zip(read, given, strict=True)]


def test_the_logged_numbers_have_the_digest_of_what_the_policy_was_given(walked):
    log, _ = walked
    digests = [m.observation_digest for _, _, m in log.messages("/nw/policy")]
    names = ("proprio", "scandots", "last_output", "history")
    columns = [[values for _, values in log.observations(name)] for name in names]
    rows = [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
    assert [observation_digest(row) for row in rows] == digests
    assert len(rows) == 100


@pytest.mark.parametrize("name", ["body", "past", "map", "rays", "row"])
def test_numbers_are_the_policy_s_bit_for_bit_at_their_own_rate(watched, name):
    log, given = watched
    for values, expected in pairs(log.observations(name), given[name]):
        assert (values.dtype, values.shape) == (np.float32, expected.shape)
        assert values.tobytes() == expected.tobytes()
    if name == "rays":
        assert expected.size > MANY


def test_numbers_of_the_body_have_the_names_of_their_terms(watched):
    log, given = watched
    first = next(message for _, _, message in log.messages("/observation/body"))
    terms = {term.name: list(term.values) for term in first.terms}
    assert list(terms) == ["gravity", "command", "joint_pos"]
    assert [len(values) for values in terms.values()] == [3, 3, 12]
    assert terms["gravity"] == given["body"][0][1][:3].tolist()


def test_each_number_of_the_body_has_a_name_and_a_past_one_that_of_its_age(walked):
    log, _ = walked
    names = log.elements()
    now = [dict(zip(names["/observation/proprio"], values.tolist(), strict=True))
           for _, values in log.observations("proprio")]  # fmt: skip
    past = [dict(zip(names["/observation/history"], values.tolist(), strict=True))
            for _, values in log.observations("history")]  # fmt: skip
    aged = [name.rpartition(" t-") for name in names["/observation/history"]]
    assert {age for _, _, age in aged} == {"1", "2", "3"}
    for step in (3, 50, 99):
        for name, _, age in aged:
            was = now[step - int(age)][name]
            assert past[step][f"{name} t-{age}"] == was
    assert now[50]["joint_pos FR_hip"] != now[50]["joint_pos FL_hip"]


def test_names_follow_the_order_of_the_card_and_targets_that_of_the_robot(watched, walked):
    past = {"steps": 2, "by": "term"}
    spec = ProprioObservation.model_validate(
        {"sensor": "proprio", "terms": ["joint_pos", "command"], "history": past}
    )
    assert element_names(spec, ["RL_calf_joint", "FR_hip"]) == (
        "joint_pos RL_calf t-1", "joint_pos FR_hip t-1", "joint_pos RL_calf", "joint_pos FR_hip",
        "command forward t-1", "command left t-1", "command yaw_rate t-1",
        "command forward", "command left", "command yaw_rate",
    )  # fmt: skip
    joints = tuple(name.removesuffix("_joint") for name in get_robot("go1").joints)
    assert walked[0].elements()["/nw/policy.targets"] == joints
    assert set(watched[0].elements()) == {
        "/nw/policy.action", "/nw/policy.applied", "/nw/policy.targets",
        "/observation/body", "/observation/past",
    }, "pictures and scans have no names"  # fmt: skip


def test_depth_is_what_the_policy_saw_to_half_a_millimetre(watched):
    log, given = watched
    for metres, expected in pairs(log.frames("ego/metres"), given["metres"]):
        seen = expected > 0.0005
        assert seen.mean() > 0.9
        np.testing.assert_allclose(metres[seen], expected[seen], rtol=0, atol=0.5001e-3)
        assert (metres[~seen] <= 0.0005).all()


def test_other_numbers_of_an_image_are_kept_bit_for_bit_of_a_stack_the_newest(watched):
    log, given = watched
    for seen, expected in pairs(log.frames("ego/near"), given["near"]):
        assert expected.shape == (3, 10, 20)
        assert seen.tobytes() == expected[-1].tobytes()
    [calibration] = [m for _, _, m in log.messages("/camera/ego/near/calib")]
    # 24 rows span 90 degrees; 4 are cut off, and the other 20 become 10.
    assert (calibration.width, calibration.height) == (20, 10)
    assert (calibration.K[4], calibration.K[5]) == pytest.approx((6.0, 4.0))


def test_classes_are_kept_as_they_are_and_shown_in_their_colours(watched):
    log, given = watched
    for classes, expected in pairs(log.frames("ego/classes"), given["classes"]):
        np.testing.assert_array_equal(classes, expected)
    for colours, expected in pairs(log.frames("ego/drawing"), given["drawing"]):
        np.testing.assert_array_equal(colours, expected)
    from io import BytesIO

    from PIL import Image

    first = next(message for _, _, message in log.messages("/camera/ego/classes"))
    shown = np.asarray(Image.open(BytesIO(first.data)).convert("RGB"))
    np.testing.assert_array_equal(shown, PALETTE[given["classes"][0][1]])


def test_photographs_are_the_policy_s_own_and_no_other_camera_s(watched):
    log, given = watched
    for photo, expected in pairs(log.frames("ego"), given["photo"]):
        newest = expected[-1].transpose(1, 2, 0) * 255.0
        assert np.abs(photo - newest).mean() < 6.0, "JPEG"
    for grey, expected in pairs(log.frames("ego/grey"), given["grey"]):
        assert np.abs(grey.astype(float) - expected).mean() < 6.0
    frames = [topic for topic in log.topics() if topic.startswith("/camera/")]
    kinds = ("", "/grey", "/metres", "/near", "/classes", "/drawing")
    pictures = {f"/camera/ego{kind}" for kind in kinds}
    assert set(frames) == pictures | {f"{topic}/calib" for topic in pictures}


def test_a_policy_that_sees_depth_only_is_shown_no_photograph(make_job, library, tmp_path):
    card = re.sub(r"(?m)^  (?!metres)\w+: .*\n(    .*\n)*", "", CARD)
    (tmp_path / "policy.yaml").write_text(card)
    path = tmp_path / "depth.mcap"
    job = make_job(policy=str(tmp_path), mcap=path, record="all", duration=0.3)
    run_trial(job, library=library)
    found = {topic for topic in LogReader(path).topics() if topic.startswith("/camera")}
    assert found == {"/camera/ego/metres", "/camera/ego/metres/calib"}


def test_pictures_and_large_scans_go_where_images_go(folder, make_job, library, tmp_path):
    path = tmp_path / "none.mcap"
    job = make_job(policy=str(folder), mcap=path, record="none", duration=0.3)
    run_trial(job, library=library)
    topics = LogReader(path).topics()
    assert "/observation/body" in topics
    assert "/observation/rays" not in topics
    assert not [topic for topic in topics if topic.startswith("/camera/")]


def test_a_log_says_how_long_a_camera_takes_that_takes_time(watched, walked):
    assert "nw.shutters" not in walked[0].metadata()
    found = watched[0].metadata()["nw.shutters"]
    assert json.loads(found.pop("ego")) == {"readout": 0.02, "exposure": 0.01}
    assert found == {}


def test_twist_is_the_simulator_s_velocity_in_the_frame_of_the_trunk(walked, library):
    log, job = walked
    twists = {time: message for _, time, message in log.messages("/robot/twist")}
    with open_trial(job, library, StageClock()) as trial:
        world = trial.episode.world
        for state in log.states()[3::4]:
            trial.episode.restore(state)
            twist = twists[round(world.time * 1e9)]
            velocity, turning = world._data.qvel[:3], world._data.qvel[3:6]
            linear = [twist.linear.x, twist.linear.y, twist.linear.z]
            angular = [twist.angular.x, twist.angular.y, twist.angular.z]
            assert linear == pytest.approx(world.trunk_rotation.T @ velocity, abs=1e-6)
            assert angular == pytest.approx(turning, abs=1e-6)
            assert twist.frame_id == "trunk"
    assert max(abs(m.linear.x) for m in twists.values()) > 0.5, "it walks"


def test_the_command_is_the_one_that_the_policy_was_given(watched):
    log, given = watched
    logged = [m for _, _, m in log.messages("/robot/command")]
    # `body` has noise of 0.01 on it.
    seen = np.array([array[3:6] for _, array in given["body"]])
    asked = np.array([(m.forward, m.left, m.yaw_rate) for m in logged])
    np.testing.assert_allclose(asked, seen, atol=0.06)
    assert np.abs(asked - seen).mean() < 0.012
    assert {m.frame_id for m in logged} == {"heading"}


def test_the_path_is_where_the_trunk_was_and_the_trail_is_where_it_should_go(walked, library):
    log, _ = walked
    odom = {time: m.pose.position for _, time, m in log.messages("/robot/odom")}
    times = list(odom)
    *_, (_, last, cloud) = log.messages("/robot/path")
    points, _ = cloud_points(cloud)
    # 10 Hz; the last one is both the end of a period and of the trial.
    expected = [odom[time] for time in times[::5]]
    assert last == times[-1]
    np.testing.assert_allclose(points, [(p.x, p.y, p.z) for p in expected], atol=1e-6)

    [scene] = [m for _, _, m in log.messages("/scene")]
    [line] = [entity.lines[0] for entity in scene.entities if entity.id == "trail"]
    corners = np.array([(p.x, p.y, p.z) for p in line.points])
    trail = library.only.trail
    np.testing.assert_allclose(corners[0, :2], points[0, :2], atol=1e-6)
    drawn = next(m for _, _, m in log.messages("/waypoints"))
    placed = [
        (e.cylinders[0].pose.position.x, e.cylinders[0].pose.position.y) for e in drawn.entities
    ]
    np.testing.assert_allclose(corners[1:, :2], placed, atol=1e-6)
    assert np.abs(np.array(placed) - trail[:, :2]).max() < 0.3, "the trail's noise"

    first, *_, done = [m for _, _, m in log.messages("/points/trail")]
    dots, colours = cloud_points(done)
    np.testing.assert_allclose(dots[-1], [*placed[-1], trail[-1, 2]], atol=1e-6)
    is_green = colours[:, 1] > colours[:, 0]
    reach = np.argmin(np.linalg.norm(dots[:, :2] - placed[0], axis=1))
    assert is_green[: reach + 1].all()
    assert not is_green[reach + 1 :].any()
    assert not (cloud_points(first)[1][:, 1] > cloud_points(first)[1][:, 0]).any()


def test_points_of_the_place_lie_on_its_faces_and_those_of_the_robot_in_its_bodies(walked, library):
    log, _ = walked
    [cloud] = [m for _, _, m in log.messages("/points/place")]
    points, _ = cloud_points(cloud)
    corners = library.only.mesh().vertices
    assert len(points) == 3000
    assert (points >= corners.min(axis=0) - 0.01).all()
    assert (points <= corners.max(axis=0) + 0.01).all()
    assert (np.abs(points[:, 2]) < 0.005).sum() > 100, "ground"
    [trunk] = [m for _, _, m in log.messages("/points/robot/trunk")]
    assert trunk.frame_id == "trunk"
    assert np.abs(cloud_points(trunk)[0]).max() < 0.5


def test_a_ring_around_each_waypoint_turns_green_where_the_robot_has_been(walked):
    log, _ = walked
    last = None
    for drawn, cloud in zip(
        log.messages("/waypoints"), log.messages("/points/waypoints"), strict=True
    ):
        (_, when, discs), (_, also, last) = drawn, cloud
        assert when == also
        places = [entity.cylinders[0] for entity in discs.entities]
        points, colours = cloud_points(last)
        rings = points.reshape(len(places), -1, 3)
        of_rings = colours.reshape(*rings.shape[:2], 4)
        for disc, ring, colour in zip(places, rings, of_rings, strict=True):
            centre = (disc.pose.position.x, disc.pose.position.y)
            radii = np.linalg.norm(ring[:, :2] - centre, axis=1)
            np.testing.assert_allclose(radii, 0.3, atol=0.01)
            assert colour[0].tolist() == [round(255 * c) for c in _rgba(disc.color)]
    assert last is not None


def _rgba(color):
    return color.r, color.g, color.b, color.a


def topic_of(path):
    """Return the topic of a message path."""
    return re.match(r"(/[\w/]+)", path)[1]


def value_at(message, path):
    """Return what a path such as `/topic.field[2].other` names in a message of that topic."""
    for field, index in re.findall(r"\.(\w+)(?:\[(\d+)\])?", path):
        message = getattr(message, field)
        message = message[int(index)] if index else message
    return message


@pytest.mark.parametrize("policy", ["go1-parkour", "watches"])
def test_the_layout_names_topics_that_are_there(policy, folder, walked, watched):
    log = walked[0] if policy == "go1-parkour" else watched[0]
    card = load_bundle(policy if policy == "go1-parkour" else str(folder)).card
    shown = shown_by_card(card, get_robot("go1"))
    layout = json.loads(layout_json(shown))
    panels = layout["configById"]
    named = set(panels["3D!place"]["topics"])
    for name, panel in panels.items():
        named |= {topic_of(path["value"]) for path in panel.get("paths", ())}
        named |= {panel[key] for key in ("topicToRender", "topicPath") if key in panel}
        if name.startswith("Image!"):
            named.add(panel["imageMode"]["imageTopic"])
    assert named <= set(log.topics())
    assert {"/scene", "/robot/path", "/robot/twist", "/log", "/camera/ego"} <= named
    assert replace(shown_in_log(log), start=None) == shown, "a log shows what its card promised"
    assert panels["3D!place"]["followTf"] == "trunk"
    frames = next(m for _, _, m in log.messages("/tf")).transforms
    assert "trunk" in {transform.child_frame_id for transform in frames}
    first = {topic: message for topic, _, message in reversed(list(log.messages()))}
    for panel in panels.values():
        for line in panel.get("paths", ()):
            topic = topic_of(line["value"])
            assert isinstance(value_at(first[topic], line["value"]), float), line
            if "label" in line and topic.startswith("/observation"):
                values = [v for term in first[topic].terms for v in term.values]
                place = log.elements()[topic].index(line["label"])
                assert values[place] == value_at(first[topic], line["value"])

    def leaves(tree):
        return (
            [tree] if isinstance(tree, str) else [*leaves(tree["first"]), *leaves(tree["second"])]
        )

    assert sorted(leaves(layout["layout"])) == sorted(panels), "each panel has its place"


def test_the_table_of_topics_names_every_topic_of_a_log_with_its_schema(walked, watched):
    patterns = [
        (re.compile(re.sub(r"<\w+>", "[^/]+", t.name).replace("[^/]+/calib", ".+/calib") + "$"), t)
        for t in TOPICS
    ]
    used = set()
    for log in (walked[0], watched[0]):
        for topic, _, message in log.messages():
            schema = message.DESCRIPTOR.full_name
            found = [t for p, t in patterns if p.match(topic) and t.schema == schema]
            assert found, f"{topic} ({schema}) is not in the table"
            used.update(t.name + t.schema for t in found)
    assert used == {t.name + t.schema for t in TOPICS}


def test_a_log_has_the_scores_of_its_trial_as_far_as_it_went(walked, make_job, library, tmp_path):
    log, job = walked
    written = [
        (time, {term.name: term.values[0] for term in message.terms})
        for _, time, message in log.messages("/scores")
    ]
    assert [time / 1e9 for time, _ in written] == pytest.approx([0.4, 0.8, 1.2, 1.6, 2.0, 2.0])
    early, (_, last) = written[:-1], written[-1]
    assert {frozenset(values) for _, values in early} == {frozenset({"mean_power", "expect_slow"})}
    assert [values["expect_slow"] for _, values in early] == sorted(
        (values["expect_slow"] for _, values in early), reverse=True
    ), "once it is broken it stays so"
    for time, values in early[1:3]:
        short = run_trial(make_job(scores=SCORES, duration=time / 1e9), library=library)
        assert values["mean_power"] == pytest.approx(dict(short.scores)["mean_power"], rel=1e-6)
    plain = run_trial(replace(job, mcap=None, record="none"), library=library)
    assert last == pytest.approx(dict(plain.scores), rel=1e-6)
    recorded = json.loads(log.metadata()["nw.verdict"]["scores"])
    assert recorded == dict(plain.scores), "a log changes no bit of them"

    path = tmp_path / "bare.mcap"
    bare = run_trial(replace(job, mcap=path, scores=()), library=library)
    assert (bare.state_digest, bare.action_digest) == (plain.state_digest, plain.action_digest)
    assert "/scores" not in LogReader(path).topics()
