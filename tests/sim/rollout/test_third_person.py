"""What a spectator sees: a robot that stands in its place, whether that has a splat or not."""

import json
from io import BytesIO

import numpy as np
import pytest
from PIL import Image as PillowImage

from nw_base.errors import UsageError
from nw_base.trials import Trial
from nw_eval import api
from nw_policies import load_bundle
from nw_scenes.rays import RayScene
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.rollout.job import TrialJob
from nw_sim.rollout.replaying import film
from nw_sim.rollout.replaying.logged import read_logged_trial
from nw_sim.rollout.replaying.third_person import ContactShadow, Spectator
from nw_sim.rollout.trial import run_trial
from nw_sim.sensors.drawing.pictures import draw_sheet
from nw_splat.camera import Pixels
from nw_splat.image import Image

SCENE = """\
nw-scene: 1
name: mine/kerb
licence: MIT
title: a kerb of 15 cm that somebody has measured with a rule
task: hurdles
trail: [[1.2, 0, 0.15], [3, 0, 0]]
spawn: {position: [0, 0, 0], yaw: 0.0}
collision: boxes.json
"""
BOXES = {"boxes": [{"center": [1.2, 0, 0.075], "half_size": [0.2, 1.0, 0.075]}]}
SUITE = """\
nw-eval: 1
name: short
robot: go1
policy: stand
trials: 1
seed: 5
episode: {duration: 0.3}
scenes: [kerb]
"""
NOWHERE = np.zeros((0, 3))


@pytest.fixture
def suite(tmp_path, monkeypatch):
    """A suite whose one scene is a folder without a splat."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kerb").mkdir()
    (tmp_path / "kerb" / "scene.yaml").write_text(SCENE)
    (tmp_path / "kerb" / "boxes.json").write_text(json.dumps(BOXES))
    path = tmp_path / "short.yaml"
    path.write_text(SUITE)
    return path


@pytest.fixture
def kerb(suite):
    return get_scene(str(suite.parent / "kerb"))


@pytest.fixture
def standing(kerb):
    robot = get_robot("go1")
    with World(robot, kerb) as world:
        world.reset(position=(0.0, 0.0, robot.spawn_height), yaw=0.0)
        for _ in range(40):
            world.step(robot.default_pose)
        yield world


class Night:
    """A renderer of a splat that is dark everywhere, and 2 cm nearer than the ground."""

    def render(self, camera, pixels=Pixels()):  # noqa: B008 - the renderer's own signature.
        shape = (pixels.count(camera.height), pixels.count(camera.width))
        return Image(
            rgb=np.full((*shape, 3), 0.12, dtype=np.float32),
            depth=np.full(shape, 50.0, dtype=np.float32),
            alpha=np.ones(shape, dtype=np.float32),
        )


def seen(scene, world, renderer, trail=NOWHERE):
    picture = Spectator(scene, renderer).beside(world, trail, width=320, height=180)
    return picture.astype(float) / 255.0


def luminance(rgb):
    return rgb @ [0.2126, 0.7152, 0.0722]


def test_a_robot_at_night_is_about_as_dark_as_what_is_around_it(kerb, standing):
    picture = luminance(seen(kerb, standing, Night()))
    ground = 0.12
    robot = picture[np.abs(picture - np.median(picture)) > 0.004]
    assert len(robot) > 500
    assert ground / 3.0 < robot.mean() < 2.0 * ground


def test_ground_under_a_robot_is_darker_and_far_from_it_is_not(kerb, standing):
    shadow = ContactShadow(standing, RayScene(kerb.mesh()))
    x, y, _ = standing.trunk_position
    under, beside, far = shadow.factors(
        np.array([[x, y, 0.0], [x, y + 0.45, 0.0], [x - 3.0, y, 0.0]])
    )
    assert under < 0.85
    assert under < beside <= 1.0
    assert beside > 0.97
    assert far == 1.0
    # A wall that stands beside the feet is not ground.
    assert shadow.factors(np.array([[x, y, 0.2]])).tolist() == [1.0]


def test_a_robot_high_in_the_air_casts_less_of_a_shadow(kerb, standing):
    rays = RayScene(kerb.mesh())
    x, y, _ = standing.trunk_position
    low = ContactShadow(standing, rays).factors(np.array([[x, y, 0.0]]))
    standing.reset(position=(x, y, 1.2), yaw=0.0)
    high = ContactShadow(standing, rays).factors(np.array([[x, y, 0.0]]))
    assert low[0] < high[0] < 1.0


def test_the_picture_has_the_shadow(kerb, standing):
    picture = seen(kerb, standing, Night())
    plain = np.floor(0.12 * 255.0) / 255.0
    # Dark grey as the ground, but darker: neither the ground's own value nor the robot's colours.
    grey = np.ptp(picture, axis=-1) < 1e-6
    shadowed = grey & (picture[..., 0] < plain - 0.01) & (picture[..., 0] > 0.5 * plain)
    assert shadowed.sum() > 200


def test_a_scene_without_a_splat_is_drawn_by_its_mesh(kerb, standing):
    with_kerb = seen(kerb, standing, None)
    flat = seen(kerb.without_collisions(), standing, None)
    np.testing.assert_array_equal(with_kerb, flat)  # The mesh is what is seen, not the solids.
    tops = np.abs(with_kerb - np.median(with_kerb[-20:], axis=(0, 1))).max(axis=-1) > 0.05
    assert tops[:120].sum() > 1000
    assert len(np.unique(np.round(luminance(with_kerb), 2))) > 5  # Faces differ in shade.


def test_scenes_without_a_splat_have_a_sheet(kerb, tmp_path):
    film.write_scene_sheet([kerb], tmp_path / "sheet.png", width=160)
    sheet = np.asarray(PillowImage.open(tmp_path / "sheet.png"))
    assert sheet.shape[1] < 200
    assert sheet.shape[0] > 2 * 90


@pytest.fixture
def recorded(kerb, tmp_path):
    """A trial of 0.3 s in the scene, read back from its log."""
    policy = load_bundle("stand")
    trial = Trial(
        suite="short",
        suite_digest="0" * 64,
        suite_seed=5,
        scene=kerb.name,
        scene_digest=kerb.digest,
        task=kerb.task,
        index=7,
    )
    job = TrialJob(
        trial=trial,
        robot="go1",
        duration=0.6,
        scene=str(tmp_path / "kerb"),
        policy="stand",
        checkpoint_digest=policy.checkpoint_sha256,
        mcap=tmp_path / "trial.mcap",
        record="none",
    )
    assert run_trial(job).status == "ok"
    return read_logged_trial(job.mcap)


def test_a_trial_in_a_scene_without_a_splat_has_a_sheet_that_says_what_it_was(
    recorded, monkeypatch
):
    titles = []

    def draw(cells, *, across, title):
        titles.append(title)
        return draw_sheet(cells, across=across, title=title)

    monkeypatch.setattr(film, "draw_sheet", draw)
    monkeypatch.setattr(film, "_ON_SHEET", (160, 90))
    with BytesIO(film.contact_sheet(recorded)) as file:
        sheet = np.asarray(PillowImage.open(file)).astype(int)
    assert sheet.shape[1] > 2 * 160
    orange = (sheet[..., 0] > 180) & (sheet[..., 1] < 110) & (sheet[..., 2] < 60)
    assert orange.sum() > 50  # A cone.
    (title,) = titles
    for word in ("mine/kerb", "trial 007", "stand", "timeout (time)", "no splat"):
        assert word in title


def test_a_policy_with_a_camera_is_refused_such_a_scene_before_anything_runs(suite, tmp_path):
    (tmp_path / "policy.yaml").write_text(
        "nw-policy: 1\nname: eye\nrobot: go1\nadapter: zero\n"
        "control: {action: joint_position_offset}\n"
        "observations: {ahead: {sensor: splat_rgb}}\n"
    )
    with pytest.raises(UsageError, match=r"mine/kerb: no splat, which policy 'eye' .*`ahead`"):
        api.check(suite, policy=str(tmp_path))
