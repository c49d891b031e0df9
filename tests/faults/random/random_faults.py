"""Random faults at random moments of real runs, each resumed until it is done, and a tally.

    python random_faults.py COUNT [SEED [FIRST]] [--jobs N] [--fast] [--only KIND] [--out TALLY]

A case is a run of a few short trials that is hit once. It must end with the code that its fault
deserves, without a traceback, and be resumed to the rows and the verdict of the undisturbed run,
and leave no process, no lock and no half of a log. A case is drawn from seed and number, and one
that failed says how it is played again alone. Prints a line for each case and a table at the end.
"""

import argparse
import json
import os
import random
import sys
import tempfile
import time
import traceback
from pathlib import Path

import disks
from aftermath import faults_of
from case import Case
from hits import cache_of
from kinds import KINDS, possible
from origins import VERDICT, Origins, run_once
from tally import table

_RESUMES = 3


def play(origin, kind, seed):
    """Hit one run, resume it until it is done; return how it first ended and what was wrong."""
    # A process that was hit may still stand in the folder; that it goes is tested elsewhere.
    with tempfile.TemporaryDirectory(dir=origin.work, ignore_cleanup_errors=True) as name:
        case = Case(
            work=Path(name),
            draw=random.Random(seed),
            longest=origin.seconds,
            cache_gb=origin.cache_gb,
        )
        KINDS[kind].hit(case, origin)
        first = case.run.end()
        if first not in {*KINDS[kind].codes, VERDICT}:
            case.wrong.append(f"code {first}: {case.run.said[-400:]}")
        kept = case.rows()
        code = finish(case, origin, first)
        if code != VERDICT:
            case.wrong.append(f"resumed to {code}: {case.run.said[-400:]}")
        wrong = faults_of(case, origin, kept)
        is_repeated = any(row.attempt > 1 for row in case.rows().values())
        disks.forget(case.work / "disk")
    return f"{first}, a trial again" if is_repeated else str(first), wrong


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


def drawn(count, seed, first, kinds):
    """Return number and kind of cases: every kind in turn, in the order of the seed."""
    order = random.Random(seed).sample(kinds, len(kinds))
    return [(number, order[number % len(order)]) for number in range(first, first + count)]


def play_all(plan, origins, seed, results):
    """Play cases, one after the other, and write down what became of them."""
    for number, kind in plan:
        began = time.monotonic()
        ended, wrong = play(origins[KINDS[kind].origin], kind, f"{seed}-{number}")
        if wrong:
            wrong.append(f"again: 1 {seed} {number} --only '{kind}'")
        seconds = f"{time.monotonic() - began:.1f} s"
        print(f"{number:3} {kind}: {ended}; {seconds}", *wrong, sep="; ", flush=True)
        with results.open("a") as stream:
            stream.write(json.dumps({"kind": kind, "ended": ended, "wrong": wrong}) + "\n")


def fork(function, *arguments):
    """Call a function in a fork of this process; return its number."""
    child = os.fork()
    if child == 0:
        try:
            function(*arguments)
        except BaseException:  # noqa: BLE001 - said here, and missing in the tally.
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(0)
    return child


def wanted():
    """Return what the command line asks for."""
    parser = argparse.ArgumentParser()
    parser.add_argument("count", type=int)
    parser.add_argument("seed", type=int, nargs="?", default=9)
    parser.add_argument("first", type=int, nargs="?", default=0)
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time")
    parser.add_argument("--fast", action="store_true", help="without what takes longest")
    parser.add_argument("--only", help="one kind")
    parser.add_argument("--out", type=Path, help="a file for the tally")
    return parser.parse_args()


def main():
    """Play cases, every kind in turn; return 1 if any was not as it must be."""
    asked = wanted()
    disks.enter_namespace()
    kinds = [name for name in possible() if asked.only in {None, name}]
    kinds = [name for name in kinds if KINDS[name].daily or not asked.fast]
    plan = drawn(asked.count, asked.seed, asked.first, kinds)
    with tempfile.TemporaryDirectory(prefix="nw-eval-faults-", ignore_cleanup_errors=True) as name:
        work = Path(name)
        run_once(work)
        origins = Origins(work)
        origins.compute({KINDS[kind].origin for _, kind in plan})
        shares = [plan[each :: asked.jobs] for each in range(asked.jobs)]
        sys.stdout.flush()
        players = [fork(play_all, share, origins, asked.seed, work / "results") for share in shares]
        for player in players:
            os.waitpid(player, 0)
        ended = [json.loads(line) for line in (work / "results").read_text().splitlines()]
    page = table(ended, asked.seed)
    print(f"\n{page}")
    if asked.out is not None:
        asked.out.write_text(page)
    return int(len(ended) != len(plan) or any(each["wrong"] for each in ended))


if __name__ == "__main__":
    sys.exit(main())
