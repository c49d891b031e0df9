"""Success of the shipped policy in each built-in place, on its boxes and on scans of it.

    python tests/bench/bench_scans.py [trials]

Each place becomes a mesh of samples 3 cm apart, exact and with 2 mm of noise, in a scene folder of
its own. The same starts are run on all three, so that their differences are paired; +- is half of
a 95 % interval of the mean difference, over trials. Ten minutes on two cores at 3 trials a place.
"""

from __future__ import annotations

import sys
import tempfile
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "scenes" / "terrain"))

from scanned import write_scan

from nw_base.trials import Trial
from nw_policies import load_bundle
from nw_sim.catalogue import get_scene, names
from nw_sim.rollout import opening
from nw_sim.rollout.job import TrialJob
from nw_sim.rollout.library import Library
from nw_sim.rollout.trial import run_trial

TASKS = ("hurdles", "gaps", "ramps", "stairs")
NOISE = {"scan": 0.0, "noisy scan": 0.002}


def walk(place: str, trials: int) -> dict[str, list[float]]:
    """Return the share of waypoints reached in each trial, by what the place is made of."""
    scene = get_scene(place)
    bundle = load_bundle("go1-parkour")
    with tempfile.TemporaryDirectory() as folder:
        references = {"boxes": place}
        for kind, noise in NOISE.items():
            scan = write_scan(Path(folder) / kind.replace(" ", "-"), scene, noise=noise)
            references[kind] = str(scan)
        library = Library()
        return {
            kind: [one(reference, scene, index, bundle, library) for index in range(trials)]
            for kind, reference in references.items()
        }


def one(reference, scene, index, bundle, library) -> float:
    trial = Trial(
        suite="scans",
        suite_digest="0" * 64,
        suite_seed=20261,
        scene=scene.name,
        scene_digest=scene.digest,
        task=scene.task,
        index=index,
    )
    job = TrialJob(
        trial=trial,
        robot="go1",
        duration=12.0,
        scene=reference,
        policy="go1-parkour",
        checkpoint_digest=bundle.checkpoint_digest,
    )
    # A scan has a digest, and so starts, of its own; here it is given those of the place.
    with mock.patch.object(opening, "_check_same"):
        result = run_trial(job, library=library)
    assert not result.error_text, result.error_text
    return result.waypoints_reached / result.waypoints_total


def main() -> None:
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    places = [name for name in names() if name.split("/")[0] in TASKS]
    shares: dict[tuple[str, str], list[float]] = defaultdict(list)
    with ProcessPoolExecutor(2) as pool:
        results = pool.map(walk, places, [trials] * len(places))
        for place, found in zip(places, results, strict=True):
            for kind, values in found.items():
                shares[place.split("/")[0], kind] += values
    print("task     trials  boxes   " + "   ".join(f"{kind} (difference)" for kind in NOISE))
    for task in TASKS:
        boxes = np.array(shares[task, "boxes"])
        row = f"{task:8} {len(boxes):6}  {boxes.mean():.3f}"
        for kind in NOISE:
            values = np.array(shares[task, kind])
            off = values - boxes
            half = 1.96 * off.std(ddof=1) / np.sqrt(len(off))
            row += f"   {values.mean():.3f} ({off.mean():+.3f} +- {half:.3f})"
        print(row)


if __name__ == "__main__":
    main()
