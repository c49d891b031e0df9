"""Policies walk on the scan of a place as they walk on its boxes."""

from pathlib import Path

import numpy as np
import pytest
from scanned import write_scan

from nw_base.trials import Trial
from nw_policies import load_bundle
from nw_sim.catalogue import get_scene, open_scene, parse_reference
from nw_sim.rollout.job import TrialJob
from nw_sim.rollout.trial import run_trial

ROOT = Path(__file__).resolve().parents[3]
ASSETS = ROOT.parent / "shared" / "assets" / "policies"
TRIALS = 2


def success(reference, place, bundle, *, contact_termination=True, trials=TRIALS):
    """Return the mean share of waypoints that a policy reaches at one place."""
    reference, collision = parse_reference(reference)
    scene = open_scene(reference, collision)
    shares = []
    for index in range(trials):
        trial = Trial(
            suite="scans",
            suite_digest="0" * 64,
            suite_seed=20261,
            scene=place,
            scene_digest=scene.digest,
            task=scene.task,
            index=index,
        )
        job = TrialJob(
            trial=trial,
            robot=bundle.card.robot,
            duration=12.0,
            contact_termination=contact_termination,
            scene=reference,
            collision=collision,
            policy=str(bundle.card_path),
            checkpoint=bundle.checkpoint,
            checkpoint_digest=bundle.checkpoint_digest,
        )
        result = run_trial(job)
        assert not result.error_text
        shares.append(result.waypoints_reached / result.waypoints_total)
    return float(np.mean(shares))


@pytest.mark.parametrize(
    ("place", "noise"), [("stairs/five_low_corridor", 0.002), ("hurdles/one_low_carpet", 0.0)]
)
def test_the_shipped_policy_finishes_on_the_scan_of_a_place(tmp_path, place, noise):
    scan = write_scan(tmp_path / "scan", get_scene(place), noise=noise)
    assert success(str(scan), place, load_bundle("go1-parkour")) == 1.0


@pytest.mark.nightly
def test_a_mesh_touched_by_its_own_triangles_carries_the_robot_too(tmp_path):
    place = "hurdles/one_low_carpet"
    scan = write_scan(tmp_path / "scan", get_scene(place), noise=0.002)
    assert success(f"triangles:{scan}", place, load_bundle("go1-parkour")) == 1.0


@pytest.mark.skipif(not ASSETS.is_dir(), reason="third-party policies are not here")
@pytest.mark.parametrize(
    ("card", "file", "place"),
    [
        ("playground-go1", "go1_policy.onnx", "flat/carpet_room"),
        ("himloco-go2", "himloco.pt", "flat/carpet_room"),
    ],
)
def test_strangers_finish_on_a_noisy_scan_as_on_boxes(tmp_path, card, file, place):
    scan = write_scan(tmp_path / "scan", get_scene(place), noise=0.002)
    bundle = load_bundle(ROOT / "policies" / "examples" / card, checkpoint=ASSETS / card / file)
    # Where contacts of HIMLoco's chin end a trial, that is all that this would see.
    assert success(str(scan), place, bundle, contact_termination=False) == 1.0


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.skipif(not ASSETS.is_dir(), reason="third-party policies are not here")
@pytest.mark.parametrize("place", ["stairs/five_low_corridor", "stairs/five_low_podium"])
def test_a_stranger_climbs_noisy_stairs_as_those_of_boxes(tmp_path, place):
    scan = write_scan(tmp_path / "scan", get_scene(place), noise=0.002)
    card = ROOT / "policies" / "examples" / "himloco-go2"
    bundle = load_bundle(card, checkpoint=ASSETS / "himloco-go2" / "himloco.pt")
    on_scan = success(str(scan), place, bundle, trials=24)
    # A trial that falls costs up to one: the mean of 24 pairs has a standard error near 0.05.
    assert on_scan >= success(place, place, bundle, trials=24) - 0.15
