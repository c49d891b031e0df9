"""The splat engine's figures: run `python tests/bench/bench_splat.py [--quick] [--lenient]`.

Every figure is CPU time of one thread, the least of several repeats, the mean over camera poses;
the torch reference (tests/splat/splat_reference.py) runs between the engine's repeats in the same
process, so that ratios hold on a machine with other work. Exits 1 when a target is missed, unless
--lenient.
"""

import argparse
import os
import platform
import resource
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "splat"))

import numpy as np
import splat_reference
import torch
from splat_rooms import eye_camera, psnr, room

from nw_splat.camera import Pixels
from nw_splat.render import CpuRenderer
from nw_splat.store import compile_store, open_store
from nw_splat.warmup import warmup

TARGETS = {
    (100_000, 160): (6, 120),
    (500_000, 160): (8, 120),
    (2_000_000, 160): (45, 120),
    (100_000, 320): (12, 60),
    (500_000, 320): (30, 60),
    (2_000_000, 320): (80, 60),
}
"""(Gaussians, width) to (milliseconds at most, times the torch reference at least)."""

QUALITY = {100_000: 95.0, 500_000: 80.0, 2_000_000: 80.0}
PUBLISHED = Pixels(stride=16, block=2, offset=7)
MOST_BYTES = 150
_STAGES = ("cull", "project", "sort", "blend", "total")


def _reference(gaussians, camera):
    started = time.thread_time()
    rgb, _, _ = splat_reference.render(gaussians, camera)
    return time.thread_time() - started, rgb


def _case(renderer, gaussians, width, height, poses, repeats):
    """Return (mean stages in ms, torch seconds by pose, images by pose)."""
    stages, torch_seconds, pairs, counts = [], [], [], []
    for pose in range(poses):
        camera = eye_camera(pose, width, height)
        runs = [renderer.render_timed(camera) for _ in range(repeats)]
        seconds, rgb = _reference(gaussians, camera)
        runs += [renderer.render_timed(camera) for _ in range(repeats)]
        image, best = min(runs, key=lambda run: run[1].total)
        stages.append([1e3 * getattr(best, name) for name in _STAGES])
        counts.append((best.records, best.drawn, best.hidden_chunks, best.visible_chunks))
        torch_seconds.append(seconds)
        pairs.append((image.rgb, rgb))
    return np.mean(stages, axis=0), np.mean(torch_seconds), psnr(*pairs), np.mean(counts, axis=0)


def _pixel_set(renderer, repeats):
    """Milliseconds of the published 80x45 image, and of the 160x90 and 1280x720 ones."""
    cases = {
        "14,400 of 1280x720": (eye_camera(0, 1280, 720), PUBLISHED),
        "160x90": (eye_camera(0, 160, 90), Pixels()),
        "1280x720": (eye_camera(0, 1280, 720), Pixels()),
    }
    return {
        name: 1e3 * min(renderer.render_timed(*case)[1].total for _ in range(repeats))
        for name, case in cases.items()
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="up to 500k Gaussians, two poses")
    parser.add_argument("--lenient", action="store_true", help="report misses without failing")
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{platform.processor() or platform.machine()}, torch {torch.__version__}")
    print(f"warm-up {warmup():.2f} s, again {warmup():.2f} s")
    poses, repeats = (2, 5) if options.quick else (4, 6)
    misses = []

    def demand(ok, text):
        if not ok:
            misses.append(text)

    print(" Gaussians    image    cull project    sort   blend   total target    torch  ratio"
          "    PSNR  records    drawn      hidden")  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        for count in (100_000, 500_000) if options.quick else (100_000, 500_000, 2_000_000):
            gaussians = room(count)
            path = Path(folder) / f"{count}.nwsplat"
            started = time.thread_time()
            compile_store(gaussians, path)
            compiling = time.thread_time() - started
            store = open_store(path)
            renderer = CpuRenderer(store)
            for width, height in ((160, 90), (320, 180)):
                ms, reference, quality, counts = _case(
                    renderer, gaussians, width, height, poses, repeats
                )
                target, least = TARGETS[count, width]
                ratio = 1e3 * reference / ms[4]
                name = f"{count:,} at {width}x{height}"
                row = [f"{count:>10,}", f"{width:>4}x{height:<3}"]
                row += [f"{value:>7.2f}" for value in ms]
                row += [f"{target:>6}", f"{1e3 * reference:>8.0f}", f"{ratio:>6.0f}"]
                row += [f"{quality:>7.1f}", f"{counts[0]:>8.0f}", f"{counts[1]:>8.0f}"]
                print(*row, f"{counts[2]:>5.0f}/{counts[3]:<5.0f}")
                demand(ms[4] <= target, f"{name}: {ms[4]:.1f} ms, target {target}")
                demand(ratio >= least, f"{name}: {ratio:.0f}x torch, target {least}x")
                demand(quality >= QUALITY[count], f"{name}: {quality:.1f} dB")
            each = store.nbytes / store.count
            demand(each <= MOST_BYTES, f"{count:,}: {each:.0f} bytes per Gaussian")
            sets = _pixel_set(renderer, repeats)
            line = f"{'':>10} store {each:.0f} bytes per Gaussian, compiled in {compiling:.2f} s; "
            print(line + ", ".join(f"{name} {value:.2f} ms" for name, value in sets.items()))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of this process, reference included: {peak:.0f} MB")
    for miss in misses:
        print(f"MISSED {miss}")
    return 1 if misses and not options.lenient else 0


if __name__ == "__main__":
    sys.exit(main())
