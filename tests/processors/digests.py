"""Prints a digest of each thing that decides results, one a line: `what: digest`.

python tests/processors/digests.py sensors trials files      # a yard, its splat, its readings
python tests/processors/digests.py hurdles/one_low_carpet    # a built-in scene
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from nw_base.files.shipped import shipped
from nw_base.lens import Distortion
from nw_base.trials import Trial
from nw_gate.scores import BUILT_IN
from nw_policies.cards import Card
from nw_policies.cards.observations import BUILT_IN_SENSORS
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.rollout.job import TrialJob, TrialResult
from nw_sim.rollout.library import Library
from nw_sim.rollout.trial import run_trial
from nw_sim.sensors import StepContext, build_sensors
from nw_sim.sensors.sensor import Air
from nw_sim.tasks import Course, TrackSettings
from nw_splat.camera import Camera
from nw_splat.render import open_renderer
from nw_splat.store import Layout, memory_store, open_store

NEEDED = {"proprio": {"layout": "parkour53"}}
WRAPPED = {
    "resized": [{"wrapper": "resize", "width": 31, "height": 17, "method": "bilinear"}],
    "noisy": [{"wrapper": "noise", "gaussian": 0.1, "proportional": 0.02}],
}
POLICIES = ("stand", "go1-parkour", "go1-act-depth", "go1-act-rgb", "go1-act-rgb-ray")
BENT = Distortion(model="fisheye", coefficients=(0.05, -0.01, 0.003, -0.001))


def of(*arrays: object) -> str:
    """Return a digest of arrays."""
    total = hashlib.sha256()
    for array in arrays:
        whole = np.ascontiguousarray(array)
        total.update(f"{whole.dtype}{whole.shape}".encode() + whole.tobytes())
    return total.hexdigest()[:16]


def layout(held: Layout) -> str:
    """Return a digest of what a store holds."""
    return of(*held.arrays().values())


AHEAD = np.array([[0.0, 0, 1, 0.1], [-1, 0, 0, 0.05], [0, -1, 0, 0.4], [0, 0, 0, 1]])
"""Pose of a camera whose inverse is exact in any arithmetic."""


def view(distortion: Distortion | None = None) -> Camera:
    """Return a camera at knee height that looks askew."""
    T = np.eye(4)
    ahead = np.array([0.96, 0.27, -0.0725])
    ahead /= math.sqrt((ahead**2).sum())
    right = np.array([ahead[1], -ahead[0], 0.0]) / math.hypot(ahead[0], ahead[1])
    T[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    T[:3, 3] = [0.1, 0.05, 0.4]
    straight = Camera.from_fovy(width=80, height=45, fovy=1.0, T_world_camera=T)
    return replace(straight, distortion=distortion)


def built_in(name: str) -> Iterator[tuple[str, str]]:
    """Yield a digest of a built-in scene's mesh, its Gaussians, their store, and a picture."""
    from nw_places.bake.generate import generate

    scene = get_scene(name)
    mesh, gaussians = scene.mesh(), generate(scene.splat.place, None)
    parts = ("means", "log_scales", "quats", "opacity_logits", "sh")
    store = memory_store(gaussians)
    camera = Camera.from_fovy(width=80, height=45, fovy=1.0, T_world_camera=AHEAD)
    each = (
        of(mesh.vertices, mesh.faces, mesh.kinds),
        of(*(getattr(gaussians, part) for part in parts)),
        layout(store.layout),
        of(open_renderer(store).render(camera).rgb),
    )
    yield "mesh, Gaussians, store, picture", " ".join(digest[:8] for digest in each)


def files(scene) -> Iterator[tuple[str, str]]:
    """Yield digests of a splat that was read from a file, and of pictures of it."""
    store = open_store(scene.splat_store())
    yield "store of a file", layout(store.layout)
    yield "picture", of(open_renderer(store).render(view()).rgb)
    yield "picture along rays", of(open_renderer(store, projection="ray").render(view()).rgb)
    yield "picture through a lens", of(open_renderer(store).render(view(BENT)).rgb)


def sensors(scene) -> Iterator[tuple[str, str]]:
    """Yield digests of each sensor's readings, on a robot that leans."""
    depth = {"sensor": "depth", "robot": True, "cones": True}
    lidar = {"sensor": "lidar", "robot": True, "channels": 8, "columns": 90}
    observations = {
        # `reference` needs a motion: the trial of `tracker` reads it.
        **{
            name: {"sensor": name, **NEEDED.get(name, {})}
            for name in BUILT_IN_SENSORS
            if name != "reference"
        },
        **{name: depth | {"wrap": wrap} for name, wrap in WRAPPED.items()},
        "depth by stereo": {"sensor": "depth", "stereo": {}},
        "depth of the splat": {"sensor": "depth", "source": "splat", "width": 40, "height": 24},
        "midas": depth | {"mode": "midas"},
        "lidar with more": lidar,
        "lidar of the splat": {**lidar, "source": "splat", "robot": False},
        "terms": {
            "sensor": "proprio",
            "terms": ["ang_vel", "gravity", "roll_pitch", "lin_vel", "joint_pos", "joint_vel"],
        },
    }
    card = Card.model_validate(
        {
            "nw-policy": 1, "name": "c", "robot": "go1", "adapter": "zero",
            "control": {"action": "joint_position_offset"}, "observations": observations,
        }
    )  # fmt: skip
    with World(get_robot("go1"), scene) as world:
        world.reset(position=(0.3, -0.2, 0.33), yaw=0.4)
        pose = np.array(world.robot.default_pose)
        for step in range(20):
            world.step(pose + 0.1 * np.sin(0.5 * step + np.arange(12)))
        yield "state", of(world._data.qpos, world._data.qvel, world.roll_pitch_yaw)
        course = Course.along(scene.trail)
        zeros = np.zeros(12)
        for air in (Air(), Air(fog=0.1)):
            for name, sensor in build_sensors(card, world, air=air).items():
                if air.fog and name != "splat_rgb":
                    continue
                sensor.reset(3)
                values = []
                for step in range(2):
                    moment = StepContext(
                        world=world, task=course, step=5 * step, applied_action=zeros,
                        last_output=zeros,
                    )  # fmt: skip
                    values.append(np.array(sensor.read(moment)))
                yield f"{name}{' in fog' if air.fog else ''}", of(*values)


def trial(library: Library, policy: str, scene: str, **fields: object) -> TrialResult:
    """Run one trial in this process."""
    bundle, place = str(shipped("policies") / policy), library.scene(scene)
    job = TrialJob(
        trial=Trial(
            suite="s", suite_digest="0" * 64, suite_seed=1, scene=place.name,
            scene_digest=place.digest, task=place.task, index=1,
        ),
        robot="go1",
        scene=scene,
        policy=bundle,
        checkpoint_digest=library.bundle(bundle, None).checkpoint_digest,
        **fields,
    )  # fmt: skip
    result = run_trial(job, library=library)
    assert result.status == "ok", result.error_text
    return result


def trials(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield digests of the states, actions and scores of a short trial of each shipped policy."""
    library = Library()
    for name in POLICIES:
        result = trial(
            library, name, str(folder), duration=0.4, record="none", scores=tuple(BUILT_IN)
        )
        yield f"states of {name}", result.state_digest[:16]
        yield f"actions of {name}", result.action_digest[:16]
        yield f"scores of {name}", of(*(value for _, value in result.scores))
    result = trial(
        library, str(tracker(folder.with_name("tracker"))), str(folder), duration=0.6,
        record="none", task=TrackSettings(jitter=0.5),
    )  # fmt: skip
    yield "states of a tracked motion", result.state_digest[:16]
    yield "actions of a tracked motion", result.action_digest[:16]
    yield "scores of a tracked motion", of(*(value for _, value in result.scores))


def tracker(folder: Path) -> Path:
    """Write a policy that answers zeros and sees all terms of a motion of 30 Hz."""
    folder.mkdir()
    pose = [-0.3, 0.78, -1.79, 0.3, 0.78, -1.79, -0.2, 1.07, -1.63, 0.2, 1.07, -1.63]
    rows: list[list[float]] = []
    for number in range(60):
        turn = 0.02 * number
        root = [0.01 * number, 0.0, 0.27, 0.0, 0.0, math.sin(turn), math.cos(turn)]
        rows.append([*root, *(angle + 0.05 * math.sin(turn) for angle in pose)])
    text = "\n".join(",".join(map(repr, row)) for row in rows)
    (folder / "motion.csv").write_text(text + "\n")
    (folder / "policy.yaml").write_text(
        "nw-policy: 1\nname: tracker\nrobot: go1\nadapter: zero\n"
        "control: {action: joint_position_offset, scale: 0.25}\n"
        "reference: {file: motion.csv, rate: 30}\n"
        "observations:\n  motion: {sensor: reference, ahead: [0, 1], terms: [joint_positions, "
        "joint_velocities, anchor_position, anchor_orientation_6d, phase, frame]}\n"
    )
    return folder


def smoke() -> Iterator[tuple[str, str]]:
    """Yield digests of a trial of the suite `smoke`, with pictures in its log."""
    result = trial(Library(), "go1-parkour", "hurdles/one_low_carpet", duration=12.0, record="all")
    yield "states", result.state_digest
    yield "actions", result.action_digest


def yard(folder: Path) -> Path:
    """Write the scene that the sensors' tests look at, and return its folder."""
    source = Path(__file__).parents[1] / "sim" / "sensors" / "prop_scene.py"
    spec = importlib.util.spec_from_file_location("prop_scene", source)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.write_scene(folder)


def main(wanted: list[str]) -> None:
    """Print what is asked for."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = yard(Path(temporary) / "yard")
        for name in wanted:
            if name == "trials":
                found = trials(folder)
            elif name == "smoke":
                found = smoke()
            elif name in {"sensors", "files"}:
                found = {"sensors": sensors, "files": files}[name](get_scene(str(folder)))
            else:
                found = built_in(name)
            for what, digest in found:
                print(f"{name}, {what}: {digest}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
