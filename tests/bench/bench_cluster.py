"""Ray on one machine beside the local engine, and what clusters take: the table of docs/cluster.md.

    python tests/bench/bench_cluster.py [trials]

Each engine runs the same trials with as many workers as there are cores. Memory is that of the
processes of the run, as shares (PSS), so that what several map is counted once.
"""

import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from statistics import fmean

from nw_eval.engine.machine.cores import default_workers
from nw_eval.results.journal import read_journal

SUITE, SCENES = "hurdles", 16
TRIALS = int(sys.argv[1]) if len(sys.argv) > 1 else 160
WANTED = 0.9  # of the local engine's rate
MAIN = "from nw_eval.cli import main; main()"
KINDS = ("Ray", "station", "workers", "head")


def pss_by_kind(head):
    """Return MB of the processes of a run, by what they are."""
    names, parents = {}, {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with suppress(OSError, ValueError):
                stat = (folder / "stat").read_text()
                parents[int(folder.name)] = int(stat.rpartition(") ")[2].split()[1])
                names[int(folder.name)] = (folder / "cmdline").read_text("utf-8", "replace")
    found = defaultdict(lambda: [0, 0.0])
    for process in names:
        line = [process]
        while line[-1] not in {head, 0, 1} and line[-1] in parents:
            line.append(parents[line[-1]])
        if line[-1] == head:
            with suppress(OSError):
                text = Path(f"/proc/{process}/smaps_rollup").read_text()
                entry = found[_kind(line, names, head)]
                entry[0] += 1
                entry[1] += int(re.search(r"Pss:\s+(\d+)", text)[1]) / 1000
    return found


def _kind(line, names, head):
    if line[0] == head:
        return "head"
    if any("ray::Station" in names[process] for process in line[1:]):
        return "workers"
    if "ray::Station" in names[line[0]]:
        return "station"
    if any("/ray/" in names[process] or "ray::" in names[process] for process in line):
        return "Ray"
    return "workers"


def measured(folder, *options):
    """Run the trials; return rows, trials an hour of the time in which they ran, and MB by kind."""
    command = [
        "run",
        SUITE,
        "--trials",
        str(-(-TRIALS // SCENES)),
        "--baseline",
        "none",
        "--no-cache",
    ]
    process = subprocess.Popen(
        [sys.executable, "-c", MAIN, *command, "--out", folder, *options],
        stdout=subprocess.DEVNULL,
    )
    most, lines = {}, []

    def look():
        while process.poll() is None:
            with suppress(OSError):
                lines.append((time.monotonic(), (folder / "journal.jsonl").read_text().count("\n")))
            now = pss_by_kind(process.pid)
            for kind, entry in now.items():
                most[kind] = max(most.get(kind, [0, 0.0]), entry, key=lambda each: each[1])
            time.sleep(1.0)

    thread = threading.Thread(target=look)
    thread.start()
    process.wait()
    thread.join()
    if process.returncode not in {0, 1, 3}:
        sys.exit(f"nw-eval ended with {process.returncode}")
    begun = [line for line in lines if line[1] > 1]
    (first, had), (last, have) = begun[0], next(x for x in begun if x[1] == begun[-1][1])
    return read_journal(folder / "journal.jsonl").rows, 3600 * (have - had) / (last - first), most


def table(rows, rate, most, workers):
    """Print what clusters of this machine's kind take."""
    seconds, log = 3600 * workers / rate, fmean(row.mcap_bytes for row in rows)
    shared = (most["Ray"][1] + most["station"][1]) / 1000
    worker = most["workers"][1] / workers / 1000
    print(f"\ns = {seconds:.2f} s of a core, b = {log / 1e6:.2f} MB of a log\n")
    print(f"memory: {shared:.2f} GB a node and {worker:.2f} GB a worker; "
          f"head {most['head'][1] / 1000:.2f} GB\n")  # fmt: skip
    print("| trials | 2 cores | 16 cores | 64 cores | 256 cores | logs |")
    print("|---|---|---|---|---|---|")
    for power in range(3, 7):
        trials = 10**power
        hours = [trials * seconds / 3600 / cores for cores in (2, 16, 64, 256)]
        told = " | ".join(
            f"{each:.2g} h" if each >= 0.1 else f"{60 * each:.2g} min" for each in hours
        )
        print(f"| 10^{power} | {told} | {trials * log / 1e9:.3g} GB |")
    print("\n| cores of a node | memory |\n|---|---|")
    for cores in (2, 4, 16, 64):
        print(f"| {cores} | {shared + cores * worker:.0f} GB |")


def main():
    workers = default_workers()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        _, local, _ = measured(Path(folder) / "local")
        rows, there, most = measured(Path(folder) / "ray", "--engine", "ray")
    print(f"{len(rows)} trials of {SUITE}, {workers} workers, load {load:.1f} before")
    print(f"local {local:.0f} trials an hour, Ray {there:.0f}: {there / local:.2f} of it")
    for kind in KINDS:
        count, size = most.get(kind, (0, 0.0))
        print(f"{kind:8s} {count:3d} processes {size:8.0f} MB")
    table(rows, there, most, workers)
    sys.exit(there < WANTED * local)


if __name__ == "__main__":
    main()
