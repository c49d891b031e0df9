"""Trials in a flat room whose splat is a cloud of coloured blobs, walked by the shipped policy."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from nw_base.trials import Trial
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.rollout.job import TrialJob
from nw_sim.rollout.library import Library
from nw_sim.rollout.trial import run_trial
from nw_splat.gaussians import Gaussians
from nw_splat.store import compile_store

SCENE = "flat/carpet_room"

SEEING_CARD = """\
nw-policy: 1
name: stares
robot: go1
adapter: zero
control: {action: joint_position_offset, scale: 0.25, delay_steps: 1}
observations:
  proprio: {sensor: proprio, layout: parkour53, history: {steps: 3}}
  rgb: {sensor: splat_rgb, camera: ego, width: 40, height: 24, rate: 10, latency: 0.04, stack: 2}
"""


@dataclass(frozen=True)
class Blobs:
    """A splat source of a few hundred Gaussians around the room."""

    folder: Path
    key: str = "blobs"

    def store(self, progress=None):  # noqa: ARG002
        path = self.folder / "blobs.nws"
        if not path.exists():
            rng = np.random.default_rng(3)
            count = 400
            means = rng.uniform((0.5, -3.0, 0.0), (8.0, 3.0, 2.0), (count, 3))
            gaussians = Gaussians(
                means=means.astype(np.float32),
                log_scales=np.full((count, 3), np.log(0.3), np.float32),
                quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
                opacity_logits=np.full(count, 2.0, np.float32),
                sh=rng.uniform(-1.0, 1.0, (count, 1, 3)).astype(np.float32),
            )
            compile_store(gaussians, path)
        return path


class OneScene(Library):
    """A library whose only scene is the blob room."""

    def __init__(self, scene, **options):
        super().__init__(**options)
        self.only = scene

    def scene(self, reference, collision="terrain"):
        assert (reference, collision) == (SCENE, "terrain")
        return self.only


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    blobs = Blobs(tmp_path_factory.mktemp("splat"))
    trail = np.array([[0.8, 0.0, 0.0], [2.5, 0.0, 0.0]])
    return OneScene(replace(get_scene(SCENE), splat=blobs, trail=trail))


@pytest.fixture
def run_faked(make_job, library):
    """A function that runs a trial of a policy, or in a world, of `nw_eval.testing`."""

    def run(policy=None, world=World, **settings):
        job, known = make_job(**settings), []
        if policy is not None:
            known = [policy.bundle()]
            job = replace(job, policy=known[0].reference, checkpoint_digest="fake")
        return run_trial(job, library=OneScene(library.only, known=known, world=world))

    return run


@pytest.fixture(scope="session")
def seeing(tmp_path_factory):
    """Return the folder of a policy that sees images and stands still."""
    folder = tmp_path_factory.mktemp("stares")
    (folder / "policy.yaml").write_text(SEEING_CARD)
    return str(folder)


@pytest.fixture(scope="session")
def make_job(library):
    """Return a maker of jobs: `make_job(index=0, policy="go1-parkour", mcap=...)`."""

    def make(*, index=0, policy="go1-parkour", **settings):
        scene = library.scene(SCENE)
        trial = Trial(
            suite="test",
            suite_digest="0" * 64,
            suite_seed=11,
            scene=scene.name,
            scene_digest=scene.digest,
            task=scene.task,
            index=index,
        )
        digest = library.bundle(policy, settings.get("checkpoint")).checkpoint_digest
        defaults = {"robot": "go1", "duration": 2.0, "scene": SCENE, "record": "none"}
        return TrialJob(
            trial=trial, policy=policy, checkpoint_digest=digest, **{**defaults, **settings}
        )

    return make
