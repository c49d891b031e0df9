"""Motions on a Go1: how they are fitted to it, what a policy sees, and how trials end."""

import hashlib
import io

import numpy as np
import pytest
from pydantic import ValidationError

from nw_base.errors import PolicyError, StoreError
from nw_base.trials import Trial
from nw_policies import load_bundle
from nw_policies.cards.load import card_of
from nw_scenes.mesh import rotation_matrix
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.rollout.job import StageClock, TrialJob
from nw_sim.rollout.library import Library
from nw_sim.rollout.opening import open_trial
from nw_sim.rollout.referenced import packed_motion, reference_of, unpacked_motion
from nw_sim.rollout.replaying.logged import read_logged_trial
from nw_sim.rollout.replaying.policy_switch import open_replayed
from nw_sim.rollout.replaying.takeover import take_over
from nw_sim.rollout.trial import run_trial
from nw_sim.sensors import StepContext, build_sensors
from nw_sim.tasks import TaskRules, TrackSettings, fault_of, open_task
from nw_sim.tasks.reference import PlacedReference
from nw_sim.tasks.track import Motion

SCENE = "open/field"
STANDING = [-0.3, 0.78, -1.79, 0.3, 0.78, -1.79, -0.2, 1.07, -1.63, 0.2, 1.07, -1.63]
LEAVES = ("FR_calf", "FL_calf", "RR_calf", "RL_calf")


@pytest.fixture(scope="module")
def world():
    with World(get_robot("go1"), get_scene(SCENE)) as made:
        yield made


def waving(frames=100, *, rise=0.0):
    """Poses of a root that goes ahead and turns, quaternions w last; and joints that wave."""
    time = np.arange(frames) / 50.0
    root = np.zeros((frames, 7))
    root[:, 0], root[:, 2] = 0.3 * time, 0.257 + rise * time
    root[:, 5], root[:, 6] = np.sin(0.2 * time), np.cos(0.2 * time)
    angles = np.array(STANDING) + 0.05 * np.sin(time)[:, np.newaxis] * np.arange(1, 13)
    return root, angles


def still(seconds=3):
    root = np.tile([0.0, 0.0, 0.257, 0.0, 0.0, 0.0, 1.0], (seconds * 50, 1))
    return root, np.tile(STANDING, (seconds * 50, 1))


def csv(root, angles):
    rows = np.column_stack([root, angles])
    return "\n".join(",".join(f"{x!r}" for x in row) for row in rows.tolist()).encode()


def npz(world, root, angles, order):
    """The same with all bodies, and joints in an order that the file does not say."""
    wxyz = root[:, [0, 1, 2, 6, 3, 4, 5]]
    positions, quats = world.kinematics(wxyz, angles, world.robot.bodies)
    buffer = io.BytesIO()
    np.savez(
        buffer,
        fps=np.array([50]),
        joint_pos=angles[:, order].astype(np.float32),
        joint_vel=np.zeros((len(angles), 12), np.float32),
        body_pos_w=positions.astype(np.float32),
        body_quat_w=quats.astype(np.float32),
    )
    return buffer.getvalue()


@pytest.fixture
def policy(tmp_path):
    """Write the folder of a policy that answers zeros, with a motion."""

    def write(data, *, name="motion.csv", said="rate: 50", terms="[joint_positions]", ahead=""):
        (tmp_path / name).write_bytes(data)
        (tmp_path / "policy.yaml").write_text(
            f"""\
nw-policy: 1
name: tracker
robot: go1
adapter: zero
control: {{action: joint_position_offset, scale: 0.25}}
reference: {{file: {name}, {said}}}
observations:
  motion: {{sensor: reference, terms: {terms}{ahead}}}
"""
        )
        return load_bundle(tmp_path)

    return write


def job_of(bundle, *, index=0, duration=10.0, mcap=None, **task):
    scene = get_scene(SCENE)
    trial = Trial(
        suite="track",
        suite_digest="0" * 64,
        suite_seed=3,
        scene=SCENE,
        scene_digest=scene.digest,
        task=scene.task,
        index=index,
    )
    return TrialJob(
        trial=trial,
        robot="go1",
        task=TrackSettings(**task),
        duration=duration,
        contact_termination=False,
        scene=SCENE,
        policy=bundle.reference,
        checkpoint_digest=bundle.checkpoint_digest,
        mcap=mcap,
        attachments=(("policy.yaml", bundle.card_text),),
    )


def opened(bundle, **changes):
    return open_trial(job_of(bundle, **changes), Library(), StageClock())


def tracked(bundle, **changes):
    return run_trial(job_of(bundle, **changes))


def motion_of(bundle, world):
    return reference_of(bundle, world, bundle.card)


def test_a_csv_is_interpolated_to_the_control_rate(policy, world):
    root, angles = waving(61)
    motion = motion_of(policy(csv(root, angles), said="rate: 30"), world)
    # As csv_to_npz.py of whole_body_tracking: a frame each 0.02 s from 0 to before the end at 2 s.
    times = np.arange(0.0, 2.0, 0.02) * 30.0
    assert len(motion) == len(times) == 100
    for joint in range(12):
        expected = np.interp(times, np.arange(61), angles[:, joint])
        np.testing.assert_allclose(motion.joint_positions[:, joint], expected, atol=1e-12)
    # The root turns about z by 0.2 rad/s of its half angle a frame of 1/50 s; 30 of them a second.
    np.testing.assert_allclose(motion.root[:, 12], 2 * 0.2 * 30 / 50, atol=1e-9)
    np.testing.assert_allclose(motion.root[:, 7], 0.3 * 30 / 50, atol=1e-9)
    np.testing.assert_allclose(
        motion.joint_velocities[50], (angles[31] - angles[29]) * 15, atol=2e-4
    )


@pytest.mark.parametrize("kind", ["own", "breadth first"])
def test_the_order_of_joints_follows_from_the_bodies(policy, world, kind):
    root, angles = waving()
    # Isaac Lab has all hips first, then all thighs, then all calves.
    order = list(range(12)) if kind == "own" else [0, 3, 6, 9, 1, 4, 7, 10, 2, 5, 8, 11]
    bundle = policy(npz(world, root, angles, order), name="motion.npz", said="anchor: trunk")
    motion = motion_of(bundle, world)
    np.testing.assert_allclose(motion.joint_positions, angles, atol=1e-6)


def test_a_motion_of_another_robot_is_refused(policy, world):
    root, angles = waving()
    data = npz(world, root, angles + np.array([0.0, 1.5, 1.2] * 4), list(range(12)))
    arrays = dict(np.load(io.BytesIO(data)))
    arrays["joint_pos"] = angles.astype(np.float32)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    with pytest.raises(PolicyError, match=r"lie 0\.\d+ m beside those of the robot go1"):
        motion_of(policy(buffer.getvalue(), name="motion.npz", said="anchor: trunk"), world)


@pytest.mark.parametrize(
    ("said", "cut", "words"),
    [
        ("anchor: trunk", 12, "does not say how many frames"),
        ("rate: 50", 10, "has 10 joints without names, the robot go1 has 12"),
        ("rate: 50, joints: [FR_hip, FL_hip]", 12, "`reference` names 2"),
        ("rate: 2000", 12, "shorter than two control steps"),
    ],
)
def test_what_the_card_must_say_is_asked_for(policy, world, said, cut, words):
    root, angles = waving(20)
    with pytest.raises(PolicyError, match=words):
        motion_of(policy(csv(root, angles[:, :cut]), said=said), world)


def test_a_motion_of_very_few_frames_a_second_takes_no_memory(policy, world):
    arrays = dict(np.load(io.BytesIO(npz(world, *waving(3), list(range(12))))))
    arrays["fps"] = np.array([1e-6])
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    with pytest.raises(PolicyError, match="3 frames at 1e-06 a second are more than 200000"):
        motion_of(policy(buffer.getvalue(), name="motion.npz", said="anchor: trunk"), world)


def test_joints_that_a_file_lacks_keep_the_default_pose(policy, world):
    root, angles = waving()
    bundle = policy(csv(root, angles[:, [3, 0]]), said="rate: 50, joints: [FL_hip, FR_hip]")
    motion = motion_of(bundle, world)
    np.testing.assert_allclose(motion.joint_positions[:, [0, 3]], angles[:, [0, 3]])
    np.testing.assert_array_equal(
        motion.joint_positions[:, 1:3], [world.robot.default_pose[1:3]] * 100
    )


def test_end_effectors_are_the_bodies_that_none_hangs_on(policy, world):
    motion = motion_of(policy(csv(*waving())), world)
    assert {motion.bodies[k] for k in motion.ends} == {*LEAVES, "face"}


def test_a_placed_motion_begins_over_its_place_with_its_heading(policy, world):
    motion = motion_of(policy(csv(*waving())), world)
    placed = PlacedReference(motion, start=40, place=(2.0, -1.0, 0.5), yaw=1.3)
    frame = placed.at(0)
    np.testing.assert_allclose(frame.root_position, [2.0, -1.0, 0.757], atol=1e-9)
    np.testing.assert_allclose(
        rotation_matrix(frame.root_quat)[:, 0], [np.cos(1.3), np.sin(1.3), 0], atol=1e-9
    )
    # Distances between bodies of two frames stay what they are in the file.
    later = placed.at(30)
    moved = np.linalg.norm(later.positions - frame.positions, axis=1)
    np.testing.assert_allclose(
        moved, np.linalg.norm(motion.positions[70] - motion.positions[40], axis=1), atol=1e-9
    )
    assert placed.at(1000).number == len(motion) - 1


TERMS = "[joint_positions, joint_velocities, anchor_position, anchor_orientation_6d, phase, frame]"


def test_a_policy_sees_the_motion_from_its_anchor(policy):
    bundle = policy(csv(*waving()), terms=TERMS, ahead=", ahead: [0, 7]", said="rate: 50")
    with opened(bundle, start=0.4, jitter=1.0) as trial:
        episode, world = trial.episode, trial.episode.world
        seen = episode.decide().observation["motion"]
        assert seen.shape == (2 * (12 + 12 + 3 + 6 + 1 + 1),)
        for part, ahead in ((seen[:35], 0), (seen[35:], 7)):
            frame = episode.task.reference.at(ahead)
            R, place = world.trunk_rotation, world.trunk_position
            # Independently: T_robot_motion = T_world_robot^-1 T_world_motion.
            T = np.linalg.inv(np.vstack([np.column_stack([R, place]), [0, 0, 0, 1]]))
            wanted = np.eye(4)
            wanted[:3, :3] = rotation_matrix(frame.anchor_quat)
            wanted[:3, 3] = frame.anchor_position
            T = T @ wanted
            np.testing.assert_allclose(part[:12], frame.joint_positions, atol=1e-6)
            np.testing.assert_allclose(part[24:27], T[:3, 3], atol=1e-6)
            np.testing.assert_allclose(part[27:33], T[:3, :2].ravel(), atol=1e-6)
            np.testing.assert_allclose(part[33:], [(20 + ahead) / 99, 20 + ahead], atol=1e-6)


def test_a_trial_begins_in_the_pose_and_with_the_velocities_of_its_frame(policy):
    root, angles = waving()
    with opened(policy(csv(root, angles)), start=0.4) as trial:
        world = trial.episode.world
        np.testing.assert_allclose(world.joint_positions, angles[20])
        np.testing.assert_allclose(
            world.joint_velocities, (angles[21] - angles[19]) * 25, atol=1e-9
        )
        assert np.linalg.norm(world.trunk_linear_velocity) == pytest.approx(0.3)
        assert world.trunk_angular_velocity[2] == pytest.approx(0.4, abs=1e-6)


def test_a_robot_that_stands_tracks_a_motion_that_stands(policy):
    result = tracked(policy(csv(*still())), start=0.0)
    scores = dict(result.scores)
    assert (result.outcome, result.end_reason) == ("completed", "end of the motion")
    assert result.steps == 149
    assert (result.success, scores["motion_tracked"]) == (1.0, 1.0)
    assert 0.0 < scores["joint_error"] < 0.2
    assert 0.0 < scores["body_position_error"] < 0.08
    assert 0.0 < scores["anchor_error"] < 0.1


def test_a_motion_that_rises_is_lost_where_it_is_too_high(policy):
    bundle = policy(csv(*waving(150, rise=0.25)))
    result = tracked(bundle, start=0.0, lost={"ends": 1.0})
    scores = dict(result.scores)
    assert (result.outcome, result.end_reason, result.success) == ("fell", "anchor height", 0.0)
    # It rises by 0.25 m in 1 s; the robot stays near the ground.
    assert 0.8 < result.sim_seconds < 1.2
    assert scores["motion_tracked"] == pytest.approx((result.steps - 1) / 149)
    wider = tracked(bundle, start=0.0, lost={"ends": 1.0, "height": 0.5})
    assert wider.sim_seconds > result.sim_seconds + 0.5
    feet = tracked(bundle, start=0.0)
    assert feet.outcome == "off_course"
    assert feet.end_reason.startswith("height of R")


def test_a_trial_that_ends_before_its_motion_is_completed_by_time(policy):
    result = tracked(policy(csv(*still())), start=0.0, duration=1.0)
    assert (result.outcome, result.end_reason, result.steps) == ("completed", "time", 50)


def test_starts_are_drawn_by_the_seed_and_leave_what_is_asked(policy):
    bundle = policy(csv(*waving(150)))

    def start(index, **task):
        with opened(bundle, index=index, **task) as trial:
            return trial.episode.task.reference.start

    starts = [start(index, least=2.0) for index in range(12)]
    assert starts == [start(index, least=2.0) for index in range(12)]
    assert len(set(starts)) > 6
    assert max(starts) <= 149 - 100
    assert start(0, start=1.0) == 50


@pytest.mark.parametrize("start", [1.98, 1000.0, 1e308])
def test_a_start_that_leaves_no_step_of_the_motion_is_an_error(policy, start):
    bundle = policy(csv(*waving()))  # 100 frames: it ends after 1.98 s.
    result = tracked(bundle, start=start)
    assert (result.status, result.success) == ("error", 0.0)
    assert f"task.start is {start:g} s, and the policy's motion has 1.98 s" in result.error_text
    assert "give at most 1.96, or `start: drawn`" in result.error_text
    assert tracked(bundle, start=1.96).steps == 1


@pytest.mark.parametrize("start", [-1.0, -1e-9, float("nan"), float("inf")])
def test_a_start_is_a_time_from_0_on(start):
    with pytest.raises(ValidationError, match=r"start\."):
        TrackSettings(start=start)


def test_a_shorter_motion_that_is_over_completes_nothing(policy, tmp_path):
    log = tmp_path / "trial.mcap"
    tracked(policy(csv(*still())), start=0.0, mcap=log)
    policy(csv(*still(1)))
    late = take_over(log, start=1.5, policy=str(tmp_path)).result
    assert (late.status, late.success) == ("error", 0.0)
    assert "motion is over 0.98 s after the trial's start" in late.error_text
    early = take_over(log, start=0.5, policy=str(tmp_path)).result
    assert (early.outcome, early.steps) == ("completed", 49)


def test_a_policy_without_a_motion_takes_over_no_trial_of_one(policy, tmp_path):
    log = tmp_path / "trial.mcap"
    tracked(policy(csv(*still())), start=0.0, mcap=log)
    with pytest.raises(PolicyError, match=r"'stand' tracks no motion, and the task of .* is track"):
        take_over(log, start=0.5, policy="stand")


def test_a_log_holds_its_motion(policy, tmp_path):
    bundle = policy(csv(*waving()))
    log = tmp_path / "trial.mcap"
    result = tracked(bundle, start=0.2, jitter=0.5, mcap=log)
    assert not result.mcap_error
    (tmp_path / "motion.csv").unlink()
    with open_replayed(read_logged_trial(log), Library()) as trial:
        again = trial.episode.task.reference
        with opened_world() as world:
            first = motion_of_bytes(csv(*waving()), world, bundle)
        np.testing.assert_array_equal(again.motion.joint_positions, first.joint_positions)
        np.testing.assert_array_equal(again.motion.positions, first.positions)
        assert again.start == 10


def opened_world():
    return World(get_robot("go1"), get_scene(SCENE))


def motion_of_bytes(data, world, bundle):
    file = bundle.folder / "other.csv"
    file.write_bytes(data)
    named = Motion(file=str(file), sha256=hashlib.sha256(data).hexdigest(), rate=50)
    return reference_of(bundle, world, bundle.card, named)


def test_a_motion_that_the_task_names_is_tracked_in_place_of_the_cards(policy, world, tmp_path):
    bundle = policy(csv(*still()))
    data = csv(*waving())
    file = tmp_path / "elsewhere" / "wave.csv"
    file.parent.mkdir()
    file.write_bytes(data)
    named = {"file": str(file), "sha256": hashlib.sha256(data).hexdigest()}
    job = job_of(bundle, start=0.0, motion={**named, "rate": 50})
    with open_trial(job, Library(), StageClock()) as trial:
        placed = trial.episode.task.reference
        np.testing.assert_allclose(placed.motion.joint_positions, waving()[1], atol=1e-9)
    assert job.also == (file,)
    # Its frames count by what the task says, not by the card's 50 a second.
    slow = job_of(bundle, start=0.0, motion={**named, "rate": 25})
    with open_trial(slow, Library(), StageClock()) as trial:
        assert len(trial.episode.task.reference.motion) == pytest.approx(200, abs=2)
    with pytest.raises(PolicyError, match="does not say how many frames"):
        open_trial(job_of(bundle, start=0.0, motion=named), Library(), StageClock())
    file.write_bytes(csv(*still()))
    with pytest.raises(PolicyError, match="the motion changed while it was in use"):
        reference_of(bundle, world, bundle.card, Motion(**named, rate=30))


def test_a_card_may_leave_its_motion_to_the_suite(policy, world, tmp_path):
    policy(csv(*still()))
    card = (tmp_path / "policy.yaml").read_text()
    card = card.replace("file: motion.csv, rate: 50", "bodies: [trunk]")
    (tmp_path / "policy.yaml").write_text(card)
    bundle = load_bundle(tmp_path)
    assert bundle.motion is None
    assert reference_of(bundle, world, bundle.card) is None
    with pytest.raises(PolicyError, match="neither the suite nor the policy's card names a motion"):
        open_trial(job_of(bundle), Library(), StageClock())
    motion = motion_of_bytes(csv(*waving()), world, bundle)
    assert motion.bodies == ("trunk",)


def test_a_damaged_motion_of_a_log_is_said(policy, world):
    bundle = policy(csv(*waving()))
    data = packed_motion(motion_of(bundle, world))
    for broken in (b"", data[:-8], data.replace(b"root", b"toor")):
        with pytest.raises(StoreError, match="holds no motion that can be read"):
            unpacked_motion(broken, world, bundle.card, "a.mcap")


def test_the_motion_is_part_of_the_policys_identity(policy):
    one = policy(csv(*waving()))
    other = policy(csv(*waving(99)))
    assert one.digest != other.digest
    assert one.computes != other.computes


def test_a_motion_that_is_not_the_one_the_card_means_is_refused(policy):
    with pytest.raises(PolicyError, match="the motion's SHA-256 is"):
        policy(csv(*waving()), said=f"rate: 50, sha256: {'f' * 64}")


def test_a_motion_that_is_missing_is_called_so(policy, tmp_path):
    policy(csv(*waving()))
    (tmp_path / "motion.csv").unlink()
    with pytest.raises(PolicyError, match=r"motion\.csv: the motion is missing") as error:
        load_bundle(tmp_path)
    assert "--checkpoint" not in error.value.fix


def test_a_card_names_bodies_and_joints_of_its_robot():
    fields = {
        "nw-policy": 1,
        "name": "tracker",
        "robot": "go1",
        "adapter": "zero",
        "control": {"action": "joint_position_offset", "scale": 0.25},
        "reference": {"file": "a.csv", "anchor": "torso", "bodies": ["FR_cal"], "joints": ["hip"]},
    }
    with pytest.raises(PolicyError) as error:
        card_of(fields)
    text = str(error.value)
    assert "reference.anchor: the robot go1 has no 'torso'" in text
    assert "reference.bodies: the robot go1 has no 'FR_cal'; did you mean 'FR_calf'" in text
    assert "reference.joints: the robot go1 has no 'hip'" in text


def test_a_card_that_observes_a_motion_leaves_it_to_suites():
    fields = {
        "nw-policy": 1,
        "name": "tracker",
        "robot": "go1",
        "adapter": "zero",
        "control": {"action": "joint_position_offset", "scale": 0.25},
        "observations": {"a": {"sensor": "reference", "terms": ["phase"]}},
    }
    card = card_of(fields)
    assert "motion" in card.hears
    assert card == card_of({**fields, "reference": {}}), "which is the same card"


def test_task_and_policy_must_both_be_of_a_motion():
    track = fault_of(TrackSettings(), hears=frozenset({"command"}), rules=TaskRules())
    assert "its card has no `reference`" in track.message
    stand = open_settings("stand")
    fault = fault_of(stand, hears=frozenset({"command", "motion"}), rules=TaskRules())
    assert fault.fix == "write task: track"
    assert fault_of(TrackSettings(), hears=frozenset({"motion"}), rules=TaskRules()) is None


def open_settings(kind):
    from nw_sim.tasks.velocity import StandSettings

    assert kind == "stand"
    return StandSettings()


def test_a_task_goes_on_from_its_state(policy):
    bundle = policy(csv(*still()))
    with opened(bundle, start=0.0) as one, opened(bundle, start=0.0) as other:
        for _ in range(30):
            one.episode.advance(one.episode.decide())
        other.episode.restore(one.episode.state())
        for trial in (one, other):
            for _ in range(20):
                trial.episode.advance(trial.episode.decide())
        assert one.episode.scores(None) == other.episode.scores(None)
        assert one.episode.state_digest.hex == other.episode.state_digest.hex


def test_a_sensor_of_motions_says_which_task_it_takes(policy, world):
    bundle = policy(csv(*waving()))
    sensors = build_sensors(bundle.card, world)
    moment = StepContext(
        world=world,
        task=open_task(open_settings("stand"), TaskRules()),
        step=0,
        applied_action=np.zeros(12),
        last_output=np.zeros(12),
    )
    with pytest.raises(Exception, match="gives no motion to track; write task: track"):
        sensors["motion"].read(moment)
