"""The closed loop: a built-in scene, photographed, built again from the photographs, compared.

    python tests/twin/loop/closed_loop.py hurdles/one_low_carpet --out loop

Prints what came of it, and leaves it in `--out`: the photographs, the twin, `figures.json`, and
`sheet.jpg` with original, twin and mesh from robot height. Stages resume, and trials that ran stay.
With `--low 8 --held-out 'low_*'` eight more photographs are taken from a robot's height, and kept
from the training of the splat. All other options are those of `nw-eval twin build`.
"""

import argparse
import json
import shutil
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from fit import FrameFit, frame_fit
from looks import LookFigures, look_figures, looks, robot_cameras
from photographs import TAG_EDGE, Phone, tag_beside_start, write_photograph
from sheet import write_sheet
from surface import SurfaceFigures, surface_figures
from trials import POLICIES, Outcome, carry, outcomes
from walk import handheld, low_over_the_course

from nw_eval import cli
from nw_sim.catalogue import get_scene
from nw_twin.place import moved_mesh
from nw_twin.reconstruct.surface import read_colour_mesh

DURATION = {"hurdles": 12.0, "gaps": 15.0, "ramps": 15.0, "stairs": 15.0}
"""Of a trial at most, as in the suites of the tasks, s."""


@dataclass(frozen=True, kw_only=True)
class Loop:
    """What came of a scene. `trials` is by policy, then by place: original, carried, own trail."""

    scene: str
    frame: FrameFit
    surface: SurfaceFigures
    looks: LookFigures
    trials: dict[str, dict[str, Outcome]]


def photograph(name, folder, *, walk=handheld, count=40, low=0, width=640, height=360, seed=0):
    """Write the photographs of a walk through a scene; return their cameras by file name."""
    scene, size = get_scene(name), {"width": width, "height": height, "seed": seed}
    files = {
        f"IMG_{number:04d}.jpg": camera for number, camera in enumerate(walk(scene, count, **size))
    }
    below = low_over_the_course(scene, low, **size)
    files |= {f"low_{number:04d}.jpg": camera for number, camera in enumerate(below)}
    folder.mkdir(parents=True, exist_ok=True)
    if {path.name for path in folder.iterdir()} != set(files):
        phone = Phone(scene, tag_beside_start(scene), seed)
        for number, (file, camera) in enumerate(files.items()):
            write_photograph(folder / file, phone.photograph(camera, number))
    return files


def build(photographs, out, options=()):
    """Run `nw-eval twin build` as anybody would."""
    words = ["twin", "build", str(photographs), "--out", str(out), "--licence", "MIT"]
    with suppress(SystemExit):
        cli.main([*words, "--tag-edge", str(TAG_EDGE), *options])
    if not (out / "scene.yaml").is_file():
        raise RuntimeError(f"no scene came of {photographs}")


def compare(name, cameras, twin, out, *, trials=20, policies=POLICIES):
    """Return what a twin is against its original, and write the sheet and `figures.json`."""
    scene, copy = get_scene(name), get_scene(twin)
    frame = frame_fit(twin, cameras, np.array(scene.spawn.position))
    line = np.vstack([scene.spawn.position, scene.trail])
    T_original_twin = np.linalg.inv(frame.T_twin_original)
    mesh = copy.mesh()
    surface = surface_figures(
        scene.mesh(),
        moved_mesh(T_original_twin, mesh.vertices, mesh.faces),
        line,
        list(cameras.values()),
    )
    coloured = read_colour_mesh(twin / "build" / "mesh" / "mesh.ply")
    views = looks(scene, copy, coloured, frame.T_twin_original, robot_cameras(line))
    write_sheet(out / "sheet.jpg", views[:: max(1, len(views) // 4)][:4])
    places = {
        "original": name,
        "carried": carry(twin, out / "carried", scene, frame.T_twin_original),
        "own trail": twin,
    }
    done = {}
    for policy in policies if trials else ():
        run = out / "runs" / policy
        shutil.rmtree(run, ignore_errors=True)
        done[policy] = outcomes(places, policy, run, duration=DURATION[scene.task], trials=trials)
    found = Loop(scene=name, frame=frame, surface=surface, looks=look_figures(views), trials=done)
    facts = asdict(found)
    facts["frame"].pop("T_twin_original")
    facts["surface"]["f"] = surface.f
    (out / "figures.json").write_text(json.dumps(facts, indent=1))
    return found


def words_of(found):
    """Return lines for people."""
    frame, surface, seen = found.frame, found.surface, found.looks
    yield (
        f"{found.scene}: {frame.registered:.0%} of the photographs placed, centres within "
        f"{1000 * frame.centres:.1f} mm, up within {frame.gravity:.2f} degrees, scale "
        f"{frame.scale:+.2%}, floor at {1000 * frame.floor:+.0f} mm"
    )
    yield (
        f"mesh: accuracy {1000 * surface.accuracy:.1f} mm, precision {surface.precision:.2f}, "
        f"completeness {surface.completeness:.2f}, F {surface.f:.2f}"
    )
    yield f"robot height: splat {seen.splat:.1f} dB, coloured mesh {seen.mesh:.1f} dB"
    for policy, places in found.trials.items():
        for place, outcome in places.items():
            failing = "none" if outcome.failing is None else f"waypoint {outcome.failing}"
            yield (
                f"{policy}, {place}: success {outcome.success:.2f} of {outcome.trials} trials, "
                f"{outcome.failures} failed, most at {failing}"
            )


def main():
    """Photograph, build, compare, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", help="a built-in scene")
    parser.add_argument("--out", type=Path, required=True, help="folder for all that comes of it")
    parser.add_argument("--photographs", type=int, default=40)
    parser.add_argument("--low", type=int, default=0, help="more, from a robot's height")
    parser.add_argument("--width", type=int, default=640, help="pixels; 16 to 9")
    parser.add_argument("--trials", type=int, default=20, help="of each policy in each place")
    words, rest = parser.parse_known_args()
    size = {"width": words.width, "height": words.width * 9 // 16, "low": words.low}
    taken = photograph(words.scene, words.out / "photographs", count=words.photographs, **size)
    build(words.out / "photographs", words.out / "twin", rest)
    found = compare(words.scene, taken, words.out / "twin", words.out, trials=words.trials)
    for line in words_of(found):
        print(line)


if __name__ == "__main__":
    main()
