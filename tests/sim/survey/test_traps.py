"""Feet that are dropped find contacts that trap them, which heights do not show."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

TRAPPED = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from nw_scenes import attach
attach.use_own_collisions = lambda: None  # MuJoCo's own collisions of height fields.
from sample_corridor import TRAIL, START, corridor
from nw_scenes import Plane, Scene
from nw_scenes.mesh import TriangleMesh
from nw_scenes.rays import RayScene
from nw_scenes.terrain import build_terrain
from nw_sim.survey.ground import drop_feet
from nw_sim.survey.ground import survey_ground
shape = corridor()
mesh = TriangleMesh(vertices=np.array(shape.vertices), faces=np.array(shape.faces, dtype=np.int32),
                    kinds=np.zeros(len(shape.faces), dtype=np.uint8))
terrain = build_terrain(mesh, trail=TRAIL, spawn=START)
scene = Scene(name="c", title="", task="stairs", solids=terrain.solids, trail=TRAIL, splat=None,
              ground=Plane(z=terrain.floor), static_mesh=mesh)
rays = RayScene(mesh)
feet = drop_feet(scene, rays, 0.2)
print(len(survey_ground(scene, rays, 0.2, 0.55).flaws), feet.sunk, feet.count, feet.deepest)
"""


def test_feet_that_mujoco_traps_in_height_fields_are_found_though_heights_are_right():
    here = str(Path(__file__).parent)
    run = subprocess.run(
        [sys.executable, "-c", TRAPPED, here], capture_output=True, text=True, check=True
    )
    flaws, sunk, count, _deepest = run.stdout.split()
    assert int(flaws) == 0
    assert int(sunk) > 0.1 * int(count), run.stdout
