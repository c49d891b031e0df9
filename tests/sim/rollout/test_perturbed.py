"""What a cell of the perturbation grid changes, by walking and by looking."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from nw_base.errors import UsageError
from nw_policies.cards import Card
from nw_scenes.robots import get_robot
from nw_scenes.robots.spec import remounted
from nw_sim.axes import AXES, COMMANDED, Perturb
from nw_sim.rollout.job import StageClock
from nw_sim.rollout.library import Library
from nw_sim.rollout.opening import open_trial
from nw_sim.rollout.perturbed import EVERY, Pushes, TrialSetup, perturbed, unfelt
from nw_sim.rollout.trial import run_trial
from nw_sim.sensors.sensor import FOG, Air
from nw_sim.tasks import COURSE
from nw_sim.tasks.commanded import Asked, with_command
from nw_sim.tasks.velocity import VelocitySettings
from nw_splat.image import Image

PUBLISHED = "neverwhere-2026"
"""Under it every cell has the same starts, so that bits can be compared."""

FELT = {
    "friction": 0.3,
    "payload": 4.0,
    "push": 1.0,
    "strength": 0.6,
    "latency": 0.08,
    "noise": 0.2,
    "exposure": 0.4,
    "fog": 0.5,
    "camera_pitch": 0.3,
    "camera_height": 0.1,
    "field_of_view": 0.7,
    "missing_cones": 1.0,
    "speed": 0.3,
    "turn_rate": 0.4,
}
SEES = ("exposure", "fog", "camera_pitch", "camera_height", "field_of_view", "missing_cones")
WALKS = [axis for axis in FELT if axis not in {*SEES, *COMMANDED}]


def walked(library, make_job, axis=None, value=0.0, *, policy="go1-parkour", duration=1.0):
    """Return the digests of states and actions of a short trial."""
    job = make_job(policy=policy, duration=duration, protocol=PUBLISHED)
    if axis is not None:
        job = replace(job, trial=replace(job.trial, perturbation=((axis, value),)))
    result = run_trial(job, library=library)
    assert result.status == "ok", result
    return result.state_digest, result.action_digest


@pytest.fixture(scope="module")
def blind(library, make_job):
    return walked(library, make_job)


@pytest.fixture(scope="module")
def seeing(library, make_job):
    return walked(library, make_job, policy="go1-act-rgb", duration=0.3)


def test_a_camera_that_its_card_says_is_tilted_sees_what_a_tilted_one_sees(library, make_job):
    job = make_job(policy="go1-act-rgb", duration=0.3, protocol=PUBLISHED)
    tilted = replace(job, trial=replace(job.trial, perturbation=(("camera_pitch", 0.26),)))
    bundle = library.bundle("go1-act-rgb", None)
    cameras = {"ego": {"pitch": 0.26}}
    card = Card.model_validate({**bundle.card.model_dump(by_alias=True), "cameras": cameras})
    own = Library(known=[replace(bundle, card=card)])
    own.scene, own.rays = library.scene, library.rays
    named = replace(job, policy=bundle.reference)

    def seen(job, library):
        with open_trial(job, library, StageClock()) as trial:
            trial.episode.advance(trial.episode.decide())
            return trial.episode.decide().observation["rgb"]

    np.testing.assert_array_equal(seen(named, own), seen(tilted, library))
    assert (seen(named, own) != seen(job, library)).any()
    assert replace(bundle, card=card).digest != bundle.digest


def test_every_axis_is_tried_here():
    assert set(FELT) == set(AXES) == set(Perturb.model_fields)


@pytest.mark.parametrize("axis", WALKS)
def test_an_axis_of_body_and_ground_moves_the_robot(library, make_job, blind, axis):
    duration = 3.0 if axis == "push" else 1.0  # Within which one push falls at least.
    plain = walked(library, make_job, duration=duration) if axis == "push" else blind
    assert walked(library, make_job, axis, FELT[axis], duration=duration)[0] != plain[0]


@pytest.mark.parametrize("axis", SEES)
def test_an_axis_of_pictures_moves_a_policy_that_sees(library, make_job, seeing, axis):
    options = {"policy": "go1-act-rgb", "duration": 0.3}
    assert walked(library, make_job, axis, FELT[axis], **options)[1] != seeing[1]


@pytest.mark.parametrize("axis", [axis for axis in WALKS if axis != "friction"])
def test_a_neutral_value_changes_no_bit(library, make_job, blind, axis):
    assert walked(library, make_job, axis, AXES[axis].neutral) == blind


@pytest.mark.parametrize(
    ("axis", "asked", "velocity"),
    [
        ("speed", {"draw": {"vx": [0.6, 0.8]}}, {"vx": 0.3}),
        ("speed", {"constant": {"vx": 0.6, "yaw": 0.1}}, {"vx": 0.3, "yaw": 0.1}),
        ("turn_rate", {"sweep": {"yaw": [0.0, 0.2], "over": 1.0}}, {"yaw": 0.4}),
    ],
)
def test_an_axis_of_the_command_is_that_constant_command(library, make_job, axis, asked, velocity):
    def walked_at(command, cell=()):
        job = make_job(policy="go1-parkour", duration=1.0, protocol=PUBLISHED)
        task = VelocitySettings.model_validate({"command": command})
        trial = replace(job.trial, perturbation=cell)
        result = run_trial(replace(job, task=task, trial=trial), library=library)
        assert result.status == "ok", result
        return result.state_digest, result.action_digest, result.scores

    changed = walked_at(asked, ((axis, FELT[axis]),))
    assert changed == walked_at({"constant": velocity})
    # The policy takes the forward speed of a command alone.
    assert (changed != walked_at(asked)) is (axis == "speed")
    settings = VelocitySettings.model_validate({"command": asked})
    told = with_command(settings, {COMMANDED[axis]: FELT[axis]}).command.constant
    assert told == Asked(**velocity)


def test_a_course_has_no_command_to_change(library, make_job):
    job = make_job(policy="go1-parkour", duration=1.0)
    trial = replace(job.trial, perturbation=(("speed", 0.3),))
    with pytest.raises(UsageError, match="task course has no velocity command"):
        open_trial(replace(job, trial=trial), library, StageClock())


@pytest.mark.parametrize("axis", SEES)
def test_a_neutral_value_changes_no_picture(library, make_job, seeing, axis):
    options = {"policy": "go1-act-rgb", "duration": 0.3}
    assert walked(library, make_job, axis, AXES[axis].neutral, **options) == seeing


def test_a_load_is_carried_and_weak_motors_give_less(library, make_job):
    def opened(axis, value):
        job = make_job()
        trial = replace(job.trial, perturbation=((axis, value),))
        return open_trial(replace(job, trial=trial), library, StageClock())

    with opened("payload", 4.0) as loaded, opened("payload", 0.0) as bare:
        mass = [float(t.episode.world._model.body_mass.sum()) for t in (loaded, bare)]
    assert mass[0] - mass[1] == pytest.approx(4.0)
    with opened("strength", 0.5) as weak, opened("strength", 1.0) as whole:
        models = [t.episode.world._model for t in (weak, whole)]
        np.testing.assert_array_equal(
            models[0].actuator_forcerange, 0.5 * models[1].actuator_forcerange
        )
        np.testing.assert_array_equal(models[0].actuator_gainprm, 0.5 * models[1].actuator_gainprm)


def test_a_push_is_felt_in_the_step_that_it_is_due(library, make_job):
    job = make_job(protocol=PUBLISHED, duration=4.0)
    trial = replace(job.trial, perturbation=(("push", 2.0),))
    pushes = Pushes(2.0, trial.generator("pushes"))
    due = next(step for step in range(200) if pushes.at(step) is not None)
    with open_trial(replace(job, trial=trial), library, StageClock()) as opened:
        episode = opened.episode
        while episode.step < due:
            episode.advance(episode.decide())
        saved, before = episode.state(), episode.world._data.qvel[:2].copy()
        episode.advance(episode.decide())
        after = episode.world._data.qvel[:2].copy()
        assert np.linalg.norm(after - before - pushes.at(due)) < 1.0
        assert np.linalg.norm(after - before) > 1.0
        episode.restore(saved)
        episode.advance(episode.decide())
        np.testing.assert_array_equal(episode.world._data.qvel[:2], after)


def test_pushes_come_every_three_seconds_at_their_speed():
    pushes = Pushes(0.7, np.random.default_rng(1))
    steps = [step for step in range(30_000) if pushes.at(step) is not None]
    assert set(np.diff(steps).tolist()) == {EVERY}
    assert 50 <= steps[0] < EVERY
    speeds = [np.linalg.norm(pushes.at(step)) for step in steps]
    np.testing.assert_allclose(speeds, 0.7)
    angles = [np.arctan2(*pushes.at(step)) for step in steps]
    assert np.std(angles) > 1.0, "in all directions"


@pytest.mark.parametrize("name", ["go1", "go2"])
def test_a_camera_looks_down_by_its_pitch_and_sits_higher(library, make_job, name):
    robot = get_robot(name)
    cell = {"camera_height": 0.1, "camera_pitch": 0.3, "field_of_view": 0.5}
    job, card = make_job(), library.bundle("go1-parkour", None).card
    moved = perturbed(TrialSetup.of(job.trial, robot, card), cell).robot
    for camera, mount in robot.cameras.items():
        # One axis after another mounts it to the bit as all at once.
        at_once = remounted(mount, pitch=0.3, height=0.1, factor=0.5)
        assert moved.cameras[camera] == at_once
        other = moved.cameras[camera]
        axis, turned = (m.T_trunk_camera[:3, 2] for m in (mount, other))
        assert np.arccos(axis @ turned) == pytest.approx(0.3)
        assert turned[2] < axis[2], "down"
        assert other.position[2] - mount.position[2] == pytest.approx(0.1)
        assert other.fovy == pytest.approx(0.5 * mount.fovy)
        np.testing.assert_allclose(mount.T_trunk_camera[:3, 0], other.T_trunk_camera[:3, 0])


def test_fog_hides_by_distance_and_exposure_scales():
    image = Image(
        rgb=np.full((1, 3, 3), 0.2, np.float32),
        depth=np.array([[1.0, 4.0, 0.0]], np.float32),
        alpha=np.ones((1, 3), np.float32),
    )
    near, far, nothing = Air(fog=0.5).seen(image).rgb[0, :, 0]
    assert near == pytest.approx(0.2 * np.exp(-0.5) + FOG * (1 - np.exp(-0.5)))
    assert far == pytest.approx(0.2 * np.exp(-2.0) + FOG * (1 - np.exp(-2.0)))
    assert nothing == pytest.approx(FOG), "where nothing was drawn, there is fog alone"
    np.testing.assert_allclose(Air(exposure=2.0).seen(image).rgb, 0.4)


def test_what_a_policy_cannot_feel_is_known(library):
    blind, seeing = (library.bundle(name, None).card for name in ("go1-parkour", "go1-act-rgb"))
    asked = VelocitySettings.model_validate({"command": {"constant": {}}})
    assert unfelt(blind, FELT, asked) == [axis for axis in FELT if axis in SEES]
    assert unfelt(seeing, FELT, asked) == []
    assert unfelt(seeing, FELT, COURSE) == list(COMMANDED), "a course has no command"


def test_values_out_of_range_and_unknown_axes_are_refused(library, make_job):
    with pytest.raises(ValidationError, match="is not a whole number of control steps"):
        Perturb(latency=(0.03,))
    with pytest.raises(ValidationError, match="less than or equal to 20"):
        Perturb(payload=(25.0,))
    job = make_job()
    wrong = replace(job, trial=replace(job.trial, perturbation=(("frictoin", 1.0),)))
    with pytest.raises(UsageError, match="there is no axis 'frictoin'; did you mean 'friction'"):
        open_trial(wrong, library, StageClock())
