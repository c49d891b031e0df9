"""Scene folders to label: a floor with whatever a test puts on it."""

import numpy as np
import trimesh

from nw_scenes.capture_file import write_captures
from nw_splat.files import write_splat
from nw_splat.gaussians import Gaussians
from nw_twin.course import propose_course
from nw_twin.label.files import open_place
from nw_twin.label.labelling import Labelling, open_labelling

SCENE = """\
# A corridor, scanned in spring.
nw-scene: 1
name: my/corridor
task: stairs  # for now
licence: CC0-1.0
title: "A corridor"
collision: collision.ply
splat: splat.ply
T_world_splat: {scale: 1.0, quat: [1.0, 0.0, 0.0, 0.0], translation: [0.0, 0.0, 0.0]}
trail:
  # the top of the step
  - [2.5, 0.0, 0.1]
  - [4.5, 0.0, 0.0]
# By how much a trial moves waypoints.
waypoint_noise: [0.0, 0.2]
"""
UNSCALED = SCENE.replace("licence:", "units: unknown\nlicence:")


def block(x, size, height, *, width=3.0, bottom=0.0):
    """A solid from x to x + size, so high, m; on the floor or above it."""
    box = trimesh.creation.box((size, width, abs(height)))
    box.apply_translation((x + size / 2, 0.0, bottom + height / 2))
    return box


def floor(x=-2.0, size=9.0, *, width=5.0):
    """A floor 0.2 m thick with its top at 0, from x to x + size."""
    box = trimesh.creation.box((size, width, 0.2))
    box.apply_translation((x + size / 2, 0.0, -0.1))
    return box


def gaussians(count=50):
    """Some Gaussians over the floor."""
    random = np.random.default_rng(0)
    return Gaussians(
        means=random.uniform((-2, -2, 0), (7, 2, 1), (count, 3)),
        log_scales=np.log(random.uniform(0.02, 0.2, (count, 3))),
        quats=random.normal(size=(count, 4)),
        opacity_logits=random.uniform(-2, 4, count),
        sh=random.normal(size=(count, 1, 3)),
    )


def written_place(folder, *solids, scene=SCENE):
    """Write a scene folder; by default a floor with a step of 0.1 m from x = 2 to 3."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh = trimesh.util.concatenate(list(solids) or [floor(), block(2.0, 1.0, 0.1)])
    mesh.export(folder / "collision.ply")
    write_splat(folder / "splat.ply", gaussians())
    (folder / "scene.yaml").write_text(scene, encoding="utf-8")
    return folder


def opened(tmp_path, *solids, propose=propose_course):
    """Return a labelling of such a place."""
    return Labelling(open_place(written_place(tmp_path / "place", *solids)), propose=propose)


def without_waypoints(labelling):
    """Take them all away."""
    while labelling.state.waypoints:
        labelling.remove_waypoint(0)


WALK = [(-1.0 + 0.5 * i, 0.2, 1.5) for i in range(15)]
"""Where a camera was carried over the floor, along x, 0.2 m to the left of its middle."""

ALONG_X = (0.5, -0.5, 0.5, -0.5)
"""A camera that looks along x, w x y z."""


def photographed(tmp_path, *solids):
    """Return a labelling of such a place that says from where it was photographed."""
    folder = written_place(tmp_path / "place", *solids, scene=SCENE + "captures: captures.json\n")
    write_captures(folder / "captures.json", [(position, ALONG_X) for position in WALK])
    return open_labelling(folder)
