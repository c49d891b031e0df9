"""Positive and negative controls: what must score 1, and what must score 0, in real scenes."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from nw_base.trials import Trial
from nw_sim.catalogue import open_scene
from nw_sim.rollout.job import TrialJob
from nw_sim.rollout.library import Library
from nw_sim.rollout.trial import run_trial

ASSETS = Path(
    os.environ.get("NW_EVAL_ASSETS", Path(__file__).resolve().parents[4] / "shared" / "assets")
)
PLAYGROUND = ASSETS / "policies" / "playground-go1" / "go1_policy.onnx"
HIMLOCO = ASSETS / "policies" / "himloco-go2" / "himloco.pt"
needs_himloco = pytest.mark.skipif(
    not HIMLOCO.is_file(), reason=f"third-party weights are not at {HIMLOCO}"
)
needs_playground = pytest.mark.skipif(
    not PLAYGROUND.is_file(), reason=f"third-party weights are not at {PLAYGROUND}"
)
SCENES = ("hurdles/one_high_stone_plaza", "hurdles/three_low", "hurdles/two_kerbs_alley")


class Edited(Library):
    """A library that changes every scene that it hands out."""

    def __init__(self, change):
        super().__init__()
        self.change = change

    def scene(self, reference, collision="terrain"):
        return self.change(open_scene(reference, collision))


def run(
    scene, *, library, policy, checkpoint=None, index=0, duration=12.0, contact_termination=True
):
    place = library.scene(scene)
    trial = Trial(
        suite="controls",
        suite_digest="0" * 64,
        suite_seed=3,
        scene=place.name,
        scene_digest=place.digest,
        task=place.task,
        index=index,
    )
    bundle = library.bundle(policy, checkpoint)
    job = TrialJob(
        trial=trial,
        robot=bundle.card.robot,
        duration=duration,
        contact_termination=contact_termination,
        scene=scene,
        policy=policy,
        checkpoint=checkpoint,
        checkpoint_digest=bundle.checkpoint_sha256,
        record="none",
    )
    result = run_trial(job, library=library)
    assert result.status == "ok", result.error_text
    return result


@pytest.fixture(scope="module")
def ghosts():
    """Return scenes whose bars are seen but cannot be touched."""
    return Edited(lambda scene: scene.without_collisions())


@pytest.mark.parametrize("scene", SCENES)
def test_doing_nothing_scores_zero(scene):
    result = run(scene, library=Library(), policy="stand")
    assert result.success == 0.0
    assert result.outcome == "stuck"


@pytest.mark.assets
@needs_playground
@pytest.mark.parametrize("scene", SCENES)
def test_a_walking_policy_scores_one_where_bars_cannot_be_touched(ghosts, scene):
    result = run(
        scene, library=ghosts, policy="examples/playground-go1", checkpoint=PLAYGROUND, duration=20
    )
    assert result.success == 1.0
    assert result.outcome == "completed"


@pytest.mark.assets
@needs_himloco
@pytest.mark.parametrize("scene", ["stairs/five_low_corridor", "stairs/landing_tiles_underpass"])
def test_a_blind_stair_climber_climbs_13_cm_by_its_card_alone(scene):
    library = Library()
    results = [
        run(
            scene,
            library=library,
            policy="examples/himloco-go2",
            checkpoint=HIMLOCO,
            index=index,
            duration=20.0,
            contact_termination=False,
        )
        for index in range(3)
    ]
    # 60 trials of its suite average 0.96; three that all stop half-way would be another policy.
    assert sum(result.success for result in results) / 3 >= 0.8
    # It feels its way: its chin touches steps.
    assert any(result.contact_s > 0.0 for result in results)


def test_the_shipped_policy_scores_one_where_bars_cannot_be_touched(ghosts):
    successes = [
        run("hurdles/three_low", library=ghosts, policy="go1-parkour", index=index).success
        for index in range(3)
    ]
    assert successes == [1.0, 1.0, 1.0]


@pytest.mark.assets
@needs_playground
def test_a_walking_policy_is_stopped_by_a_bar_of_thirty_centimetres():
    result = run(
        "hurdles/one_high_stone_plaza",
        library=Library(),
        policy="examples/playground-go1",
        checkpoint=PLAYGROUND,
    )
    assert result.success == 0.0


@pytest.mark.assets
@needs_playground
def test_a_walking_policy_walks_three_metres_in_eight_seconds_by_its_card_alone():
    # The flat room's waypoint moved to 3 m: reaching it is having walked there.
    near = Edited(lambda scene: replace(scene, trail=scene.trail[:1] * 0.0 + (3.3, 0.0, 0.0)))
    result = run(
        "flat/carpet_room",
        library=near,
        policy="examples/playground-go1",
        checkpoint=PLAYGROUND,
        duration=8.0,
    )
    assert result.outcome == "completed"
