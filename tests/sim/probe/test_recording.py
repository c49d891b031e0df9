"""Recordings of the shipped policy."""

import numpy as np

from nw_policies import load_bundle
from nw_sim.probe.recording import SceneRig


def test_a_recording_ends_once_the_robot_leans_too_far():
    bundle = load_bundle("go1-parkour")
    rig = SceneRig(bundle, scene="flat/carpet_room", allow_code=False)
    whole = rig.record(bundle.card, seconds=1.0)
    step = int(np.argmax(whole.tilt >= 0.05))
    assert 0 < step < len(whole.tilt) - 1
    short = rig.record(bundle.card, seconds=1.0, level=0.05)
    np.testing.assert_array_equal(short.tilt, whole.tilt[: step + 1])
    assert short.outcome is None
