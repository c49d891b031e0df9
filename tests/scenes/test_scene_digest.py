from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from nw_scenes.digest import digest
from nw_scenes.scene import Spawn
from nw_sim.catalogue import get_scene, names


def test_digests_of_scenes_differ_from_each_other():
    assert len({get_scene(name).digest for name in names()}) == len(names())


def test_a_digest_is_the_same_in_another_process():
    code = "from nw_sim.catalogue import get_scene; print(get_scene('hurdles/three_low').digest)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONHASHSEED": "77", "OMP_NUM_THREADS": "2"},
    )
    assert done.stdout.strip() == get_scene("hurdles/three_low").digest


def test_a_digest_changes_with_everything_that_changes_a_result():
    scene = get_scene("hurdles/one_low_carpet")
    box = scene.solids[-1]
    higher = replace(box, half_size=(*box.half_size[:2], box.half_size[2] + 0.001))
    changed = [
        replace(scene, solids=(*scene.solids[:-1], higher)),
        replace(scene, solids=(*scene.solids[:-1], replace(box, friction=(1.0, 0.3, 0.3)))),
        replace(scene, trail=scene.trail + 1e-9),
        replace(scene, spawn=Spawn(x_jitter=0.2)),
        replace(scene, waypoint_noise=(0.0, 0.2)),
        replace(scene, splat=None),
        replace(scene, T_world_splat=2 * np.eye(4)),
        replace(scene, static_mesh=get_scene("flat/carpet_room").mesh()),
    ]
    digests = {scene.digest, *(other.digest for other in changed)}
    assert len(digests) == 1 + len(changed)


def test_a_digest_does_not_change_with_names():
    scene = get_scene("hurdles/one_low_carpet")
    assert replace(scene, title="x", name="y", licence="z").digest == scene.digest


def test_equal_bytes_of_other_types_or_shapes_have_other_digests():
    values = [1, 1.0, "1", b"1", True, None, (1,), ((1,),), {"a": 1}, np.array([1.0])]
    values += [np.array([[1.0]]), np.array([1], dtype=np.int64), ("a", "b"), ("ab",), ()]
    assert len({digest(value) for value in values}) == len(values)


def test_a_value_without_an_identity_is_refused():
    with pytest.raises(TypeError, match="cannot digest"):
        digest(object())
