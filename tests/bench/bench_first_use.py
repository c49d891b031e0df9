"""What a first run waits for: `nw-eval run SUITE --trials 1` with an empty cache.

Wall time, and processor time of all its processes, with the machine's load before and after. With
another checkout's `harness` folder the two take turns, so that both meet about the same load.

    python tests/bench/bench_first_use.py [--suite gaps] [--against FOLDER] [--rounds 3]
"""

import argparse
import ctypes
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

WANTED = 0.6  # of the other checkout's wall time
_SUBREAPER = 36  # prctl's PR_SET_CHILD_SUBREAPER: processes whose parent has ended become ours.


def measure(harness: Path, suite: str) -> tuple[float, float]:
    """Return wall seconds of a run with an empty cache, and processor seconds."""

    def spent() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    with TemporaryDirectory() as place:
        environment = {
            **os.environ,
            "NW_EVAL_CACHE": f"{place}/cache",
            "PYTHONPATH": str(harness.resolve()),
        }
        command = [sys.executable, "-m", "nw_eval", "run", suite, "--trials", "1"]
        before, began = spent(), time.perf_counter()
        done = subprocess.run(
            [*command, "--out", f"{place}/run"], env=environment, capture_output=True, check=False
        )
        wall = time.perf_counter() - began
        assert done.returncode in {0, 1, 3}, done.stderr.decode()
        while True:  # Workers that outlived it by a moment.
            try:
                os.wait()
            except ChildProcessError:
                return wall, spent() - before


def main() -> None:
    """Print what each run took, and the medians."""
    asked = argparse.ArgumentParser()
    asked.add_argument("--suite", default="gaps")
    asked.add_argument("--against", type=Path)
    asked.add_argument("--rounds", type=int, default=3)
    options = asked.parse_args()
    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    checkouts = {"here": Path(__file__).parents[2] / "harness"}
    if options.against is not None:
        checkouts["there"] = options.against
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in checkouts}
    for _ in range(options.rounds):
        for name, harness in checkouts.items():
            load = os.getloadavg()[0]
            wall, cpu = measure(harness, options.suite)
            found[name].append((wall, cpu))
            print(
                f"{name:6} {wall:7.1f} s wall {cpu:7.1f} s of processors, "
                f"load {load:.1f} to {os.getloadavg()[0]:.1f}",
                flush=True,
            )
    if options.against is None:
        return
    wall, cpu = (
        median(one[kind] for one in found["here"]) / median(one[kind] for one in found["there"])
        for kind in (0, 1)
    )
    print(f"medians: {wall:.2f} of the wall time, {cpu:.2f} of the processor time")
    print(f"target {WANTED}: {'met' if wall <= WANTED else 'MISSED'}")


if __name__ == "__main__":
    main()
