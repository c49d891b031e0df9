"""Ray beside the local engine, and what clusters take: the table of docs/how-to/cluster.md.

    python tests/bench/bench_cluster.py [trials]

Each engine runs the same trials with as many workers as there are cores, those of a policy that is
told the ground, of which no picture is drawn, and those of one that sees: some minutes in all. The
rate is that of the time in which trials ended, so that starting Ray, whose seconds are told, is no
part of it. Memory is that of the processes of the run, as shares (PSS), so that what several map is
counted once.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from nw_gate.results.journal import read_journal
from nw_gate.results.provenance import usable_cores

SUITES, SCENES = ("hurdles-state", "hurdles"), 16
TRIALS = int(sys.argv[1]) if len(sys.argv) > 1 else 160
WANTED = 0.9  # of the local engine's rate
LOOP = "n = 0\nfor i in range(20_000_000): n += i"
MAIN = "from nw_eval.cli import main; main()"
KINDS = ("Ray", "station", "workers", "head")
OFTEN, SELDOM = 0.2, 10.0  # s between looks at the journal, and at memory, which costs time itself


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What a run of one engine showed."""

    rows: tuple
    first: float  # s from the command until a trial had ended
    rate: float  # trials an hour, from then on
    megabytes: dict  # by kind of process: how many, and what they held together


def pss_by_kind(head):
    """Return number and MB of the processes of a run, by what they are."""
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
    if any("ray::NodeAgent" in names[process] for process in line[1:]):
        return "workers"
    if "ray::NodeAgent" in names[line[0]]:
        return "station"
    if any("/ray/" in names[process] or "ray::" in names[process] for process in line):
        return "Ray"
    return "workers"


def measured(suite, folder, *options):
    """Run a suite's trials with one engine."""
    words = ("--trials", str(-(-TRIALS // SCENES)), "--record", "none")
    words += ("--baseline", "none", "--no-cache")
    printed = folder.with_suffix(".txt")
    began = time.monotonic()
    with printed.open("w") as stream:
        process = subprocess.Popen(
            [sys.executable, "-c", MAIN, "run", suite, "--out", folder, *words, *options],
            stdout=stream,
            stderr=subprocess.STDOUT,
        )
        ended, megabytes = watched(process, folder / "journal.jsonl")
    if process.returncode not in {0, 1, 3}:
        sys.exit(f"nw-eval ended with {process.returncode}:\n{printed.read_text()}")
    (first, had), (last, have) = ended[0], ended[-1]
    return Measured(
        rows=read_journal(folder / "journal.jsonl").rows,
        first=first - began,
        rate=3600 * (have - had) / (last - first),
        megabytes=megabytes,
    )


def watched(process, journal):
    """Return when trials had ended, and how many; and the most that processes held, by kind."""
    ended, most, next_look = [], {}, time.monotonic() + SELDOM
    while process.poll() is None:
        with suppress(OSError):
            count = journal.read_bytes().count(b"\n") - 1
            if count > (ended[-1][1] if ended else 0):
                ended.append((time.monotonic(), count))
        if time.monotonic() > next_look:
            for kind, entry in pss_by_kind(process.pid).items():
                most[kind] = max(most.get(kind, [0, 0.0]), entry, key=lambda each: each[1])
            next_look = time.monotonic() + SELDOM
        time.sleep(OFTEN)
    return ended, most


def loop_seconds():
    """Return what a loop takes alone, which tells whether others have the machine's cores."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", LOOP], check=True)
    return time.perf_counter() - began


def compare(runs, loops):
    """Print the engines side by side; return whether Ray is as fast as it must be."""
    share = runs["Ray"].rate / runs["local"].rate
    print(f"{'':24} {'local':>8} {'Ray':>8}  target")
    lines = {
        "trials": [len(each.rows) for each in runs.values()],
        "loop just before, s": loops,
        "first trial ended, s": [each.first for each in runs.values()],
        "trials an hour": [each.rate for each in runs.values()],
    }
    for what, (local, there) in lines.items():
        form = ".0f" if what.startswith("trials") else ".1f"
        print(f"{what:24} {local:8{form}} {there:8{form}}")
    held = share >= WANTED
    print(f"{'Ray, of the local rate':24} {'':8} {share:8.2f}  at least {WANTED}: {verdict(held)}")
    for kind in KINDS:
        count, size = runs["Ray"].megabytes.get(kind, (0, 0.0))
        print(f"{f'MB, {kind} ({count})':24} {'':8} {size:8.0f}")
    return held


def verdict(held):
    return "yes" if held else "NO"


def sizes(run, workers):
    """Print what clusters of this machine's kind take for such trials."""
    seconds, log = 3600 * workers / run.rate, fmean(row.mcap_bytes for row in run.rows)
    megabytes = defaultdict(lambda: (0, 0.0), run.megabytes)
    shared = (megabytes["Ray"][1] + megabytes["station"][1]) / 1000
    worker = megabytes["workers"][1] / workers / 1000
    print(f"\ns = {seconds:.2f} s of a core, b = {log / 1e6:.2f} MB of a log")
    print(
        f"memory: {shared:.2f} GB a node and {worker:.2f} GB a worker; "
        f"head {megabytes['head'][1] / 1000:.2f} GB\n"
    )
    print("| trials | 2 cores | 16 cores | 64 cores | 256 cores | logs |")
    print("|---|---|---|---|---|---|")
    for power in range(3, 7):
        trials = 10**power
        hours = [trials * seconds / 3600 / cores for cores in (2, 16, 64, 256)]
        times = " | ".join(map(span, hours))
        print(f"| 10^{power} | {times} | {trials * log / 1e9:.3g} GB |")
    print("\n| cores of a node | memory |\n|---|---|")
    for cores in (2, 4, 16, 64):
        print(f"| {cores} | {shared + cores * worker:.0f} GB |")


def span(hours):
    """Return a time with as many digits as it is worth."""
    if hours < 1.0:
        return f"{60 * hours:.0f} min"
    return f"{hours:.1f} h" if hours < 10.0 else f"{hours:.0f} h"


def main():
    workers = usable_cores()
    engines = {"local": ("--workers", str(workers)), "Ray": ("--engine", "ray")}
    held = []
    for suite in SUITES:
        loops, runs = [], {}
        with tempfile.TemporaryDirectory() as folder:
            for name, options in engines.items():
                loops.append(loop_seconds())
                runs[name] = measured(suite, Path(folder) / name, *options)
        print(f"\n{suite}, {workers} workers")
        held.append(compare(runs, loops))
        sizes(runs["Ray"], workers)
    sys.exit(not all(held))


if __name__ == "__main__":
    main()
