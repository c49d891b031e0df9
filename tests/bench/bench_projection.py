"""What pictures along the ray cost against EWA's: run `python tests/bench/bench_projection.py`.

CPU time of one thread in built-in scenes, from a Go1's camera along the way; the two are drawn in
turn, view by view, and of each the least of many repeats counts. Exits 1 when a target is missed.
"""

import argparse
import os
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from bench_truth import camera, views

from nw_sim.catalogue import get_scene
from nw_splat.render import CpuRenderer
from nw_splat.store import open_store

SCENES = ("hurdles/one_low_carpet", "gaps/three_20in_lobby", "ramps/one_ramp_plaza")
MOST = {(80, 45): 1.10, (160, 90): 1.06, (640, 360): 1.06}
"""Time along the ray over EWA's, by size."""


def least(renderers, view, repeats):
    """Return the least seconds of each renderer's frame, drawn in turn."""
    best = dict.fromkeys(renderers, float("inf"))
    for _ in range(repeats):
        for name, renderer in renderers.items():
            started = time.thread_time()
            renderer.render(view)
            best[name] = min(best[name], time.thread_time() - started)
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=30)
    options = parser.parse_args()
    is_missed = False
    for size, most in MOST.items():
        total = {}
        for name in SCENES:
            scene = get_scene(name)
            store = open_store(scene.splat_store())
            kinds = {
                "ewa": CpuRenderer(store),
                "ray": CpuRenderer(store, projection="ray"),
                "ray, 4": CpuRenderer(store, projection="ray", samples=4),
            }
            found = [least(kinds, camera(T, size), options.repeats) for T in views(scene)[::2]]
            ms = {kind: 1e3 * np.mean([each[kind] for each in found]) for kind in kinds}
            line = "  ".join(f"{kind} {value:6.2f}" for kind, value in ms.items())
            print(f"  {size[0]}x{size[1]} {name:26} {line} ms   {ms['ray'] / ms['ewa']:.3f}")
            for kind, value in ms.items():
                total[kind] = total.get(kind, 0.0) + value
        ratio = total["ray"] / total["ewa"]
        print(f"{size[0]}x{size[1]}: ray {ratio:.3f} of ewa, at most {most}")
        is_missed |= ratio > most
    return 1 if is_missed else 0


if __name__ == "__main__":
    sys.exit(main())
