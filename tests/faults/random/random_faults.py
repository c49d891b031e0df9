"""Random faults at random moments of real runs, each resumed until it is done, and a tally.

    python random_faults.py COUNT [SEED [FIRST]] [--out TALLY]

A case is a run of four short trials that is hit once. It must end with the code that its fault
deserves, without a traceback, and be resumed to the rows and the verdict of the undisturbed run, and
leave no process, no lock and no half of a log. A case is drawn from seed and number, and one that
failed says how it is played again alone.
Prints one line for each case and a table at the end.
"""

import argparse
import fcntl
import json
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

import disks
from case import Case, send
from kinds import KINDS, cache_of, possible
from origins import VERDICT, Origins, import_what_runs_import

from nw_eval.results.row import rows_digest

_RESUMES = 3
_PATIENCE = 10.0  # s until all processes must be gone


def play(origin, kind, seed):
    """Hit one run, resume it until it is done; return how it first ended and what was wrong."""
    with tempfile.TemporaryDirectory(dir=origin.work) as name:
        case = Case(work=Path(name), draw=random.Random(seed), longest=origin.seconds)
        KINDS[kind].hit(case, origin)
        first = case.run.end()
        wrong = []
        if first not in {*KINDS[kind].codes, VERDICT}:
            wrong.append(f"code {first}: {case.run.said[-400:]}")
        kept = case.rows()
        code = finish(case, origin, first)
        if code != VERDICT:
            wrong.append(f"resumed to {code}: {case.run.said[-400:]}")
        wrong += faults_of(case, origin, kept)
        ended = str(first) + (", a trial again" if has_repeated(case) else "")
        if case.folder.parent != case.work and disks.may_mount():
            disks.release(case.folder.parent)
    return ended, wrong


def has_repeated(case):
    return any(row.attempt > 1 for row in case.rows().values())


def finish(case, origin, code):
    """Resume a case's run until it has its verdict; return the last code."""
    for _ in range(_RESUMES):
        if code == VERDICT and case.folder.exists():
            break
        # Killed before anything was kept, or its folder removed: it begins again.
        way = (
            ("--resume", case.folder, *origin.resumed)
            if case.journal.exists()
            else (*origin.words, "--out", case.folder)
        )
        code = case.start(*way, cache=cache_of(case, origin)).end()
    return code


def faults_of(case, origin, kept):
    """Return what is wrong with a case that has ended, in sentences."""
    wrong = []
    rows = case.rows()
    if rows_digest(rows.values()) != origin.digest:
        wrong.append("other rows")
    if any(row.status == "ok" and rows.get(name) != row for name, row in kept.items()):
        wrong.append("a finished trial was lost")
    said = "".join(run.said for run in case.runs)
    if "Traceback" in said:
        wrong.append(f"a traceback: {said[-1500:]}")
    deadline = time.monotonic() + _PATIENCE
    while (left := case.relatives()) and time.monotonic() < deadline:
        time.sleep(0.02)
    if left:
        wrong.append(f"{len(left)} processes left")
        send(left, signal.SIGKILL)
    if not is_free(case.journal):
        wrong.append("the journal is still held")
    logs = {row.mcap_path for row in rows.values()}
    torn = [path.name for path in case.folder.rglob("*") if is_torn_twin(path, logs, case)]
    if torn:
        wrong.append(f"torn logs: {', '.join(torn)}")
    return wrong


def is_free(journal):
    try:
        with journal.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def is_torn_twin(path, logs, case):
    """Whether a file is half of a log that there is whole; else it may be all the evidence."""
    whole = path.with_suffix("").relative_to(case.folder).as_posix()
    return path.suffix == ".partial" and whole in logs


def drawn(count, seed, first, without=()):
    """Return number and kind of cases: every kind in turn, in the order of the seed."""
    kinds = [name for name in possible() if name not in without]
    kinds = random.Random(seed).sample(kinds, len(kinds))
    return [(number, kinds[number % len(kinds)]) for number in range(first, first + count)]


def play_all(plan, origins, seed, results):
    """Play cases, one after the other, and write down what became of them."""
    for number, kind in plan:
        began = time.monotonic()
        ended, wrong = play(origins[KINDS[kind].origin], kind, f"{seed}-{number}")
        seconds = f"{time.monotonic() - began:.1f} s"
        if wrong:
            wrong.append(f"repeat it with: 1 {seed} {number} --only '{kind}'")
        print(f"{number:3} {kind}: {ended}; {seconds}", *wrong, sep="; ", flush=True)
        with results.open("a") as stream:
            stream.write(json.dumps({"kind": kind, "ended": ended, "wrong": wrong}) + "\n")


def forked(function):
    """Call a function in a fork of this process; return its number."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        try:
            function()
        except BaseException:  # noqa: BLE001 - said here, and missing in the tally.
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(0)
    return child


def table(ended, seed):
    """Return the tally as Markdown."""
    failed = sum(bool(each["wrong"]) for each in ended)
    lines = [
        f"{len(ended)} faults of seed {seed}, {failed} not as they must be",
        "",
        "| fault | times | recovered | first ended with |",
        "|---|---:|---:|---|",
    ]
    for kind in sorted({each["kind"] for each in ended}):
        mine = [each for each in ended if each["kind"] == kind]
        ends = Counter(each["ended"] for each in mine)
        first = "; ".join(f"{count} x {end}" for end, count in sorted(ends.items()))
        recovered = sum(not each["wrong"] for each in mine)
        lines.append(f"| {kind} | {len(mine)} | {recovered} | {first} |")
    impossible = [name for name in KINDS if name not in possible()]
    if impossible:
        lines += ["", f"Not possible here, without mounts: {', '.join(impossible)}."]
    return "\n".join(lines) + "\n"


def main():
    """Play cases, every kind in turn; return how many were not as they must be."""
    parser = argparse.ArgumentParser()
    for name, default in (("count", None), ("seed", 9), ("first", 0)):
        parser.add_argument(name, type=int, nargs=None if default is None else "?", default=default)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time")
    parser.add_argument("--only", help="one kind")
    parser.add_argument("--fast", action="store_true", help="without kinds that render")
    asked = parser.parse_args()
    disks.enter_namespace()
    without = [
        name
        for name, kind in KINDS.items()
        if (asked.fast and kind.origin == "rendered") or asked.only not in {None, name}
    ]
    plan = drawn(asked.count, asked.seed, asked.first, without)
    with tempfile.TemporaryDirectory(prefix="nw-eval-faults-") as name:
        import_what_runs_import(Path(name))
        origins = Origins(Path(name))
        origins.compute({KINDS[kind].origin for _, kind in plan})
        results = Path(name) / "results"
        shares = [plan[each :: asked.jobs] for each in range(asked.jobs)]
        players = [forked(lambda: play_all(share, origins, asked.seed, results)) for share in shares]
        for player in players:
            os.waitpid(player, 0)
        ended = [json.loads(line) for line in results.read_text().splitlines()]
    page = table(ended, asked.seed)
    print(f"\n{page}")
    if asked.out is not None:
        asked.out.write_text(page)
    return int(len(ended) != len(plan) or any(each["wrong"] for each in ended))


if __name__ == "__main__":
    sys.exit(main())
