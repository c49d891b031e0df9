"""Runs verbs of nw-eval with one call of its own code raising: a program for test_fault_injection.

    python injection.py TEMPLATE WORK VERB CASES SEED [ELSEWHERE ...]

VERB is `run` (finish the interrupted run of TEMPLATE) or `report` (judge it). Prints one JSON line
for the verb undisturbed, and one for each case: a call site and what is raised there. A call site
is a callee with the line that calls it. CASES are drawn, 0 = all; those whose callee lies in a room
named ELSEWHERE are left out. Each runs in a fork of this process, which has imported everything.
"""

import errno
import importlib
import json
import os
import random
import shutil
import sys
from contextlib import suppress
from pathlib import Path

import nw_eval
from nw_eval.cli import main
from nw_gate.results.journal import read_journal

ROOMS = tuple(
    f"{room}/".replace("/", os.sep)
    for room in ("nw_eval/api", "nw_eval/engine", "nw_eval/reporting", "nw_gate")
)
HARNESS = f"{Path(nw_eval.__file__).parents[1]}{os.sep}"

ERRORS = {
    "disk": lambda: OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)),
    "runtime": lambda: RuntimeError("injected"),
    "exit": lambda: SystemExit(0),
}


def place(frame):
    """Return a frame's file within the package, or nothing."""
    name = frame.f_code.co_filename
    return name.removeprefix(HARNESS) if name.startswith(HARNESS) else ""


def names(*frames):
    return [frame.f_code.co_name for frame in frames if frame is not None]


def site(frame):
    """Return which call a new frame is of: callee, caller and line; None outside the rooms."""
    callee = place(frame)
    caller = frame.f_back
    if not callee.startswith(ROOMS) or "<module>" in names(frame, caller):
        return None  # Importing a module calls its body, and the bodies of its classes.
    line = f"{place(caller)}:{caller.f_lineno}" if caller and place(caller) else "a library"
    return f"{callee}:{frame.f_code.co_qualname} called by {line}"


def arguments(verb, folder):
    if verb == "run":
        return ["nw-eval", "run", "--resume", str(folder), "--workers", "1"]
    return ["nw-eval", "report", str(folder)]


def in_a_fork(work, out, err):
    """Run a function in a fork with its own output; return the exit code."""
    child = os.fork()
    if child == 0:
        code = 99
        try:
            for number, path in ((1, out), (2, err)):
                os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
            work()
        except SystemExit as left:
            code = left.code
        finally:
            sys.setprofile(None)
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def record(verb, folder, seen):
    """Run a verb undisturbed; write down its call sites and the modules that it needs."""
    sites = {}

    def listen(frame, event, _):
        if event == "call" and (found := site(frame)) is not None:
            sites.setdefault(found)

    sys.argv = arguments(verb, folder)
    try:
        sys.setprofile(listen)
        main()
    finally:
        sys.setprofile(None)
        modules = [name for name in sys.modules if name.split(".")[0] != "__main__"]
        seen.write_text(json.dumps({"sites": list(sites), "modules": modules}))


def raise_at(verb, folder, wanted, error):
    """Run a verb with the first call from one site raising."""
    sys.argv = arguments(verb, folder)
    raising(wanted, error)
    main()


def raising(wanted, error):
    """Let the first call from one site raise, from now on."""

    def listen(frame, event, _):
        if event == "call" and site(frame) == wanted:
            sys.setprofile(None)
            raise error

    sys.setprofile(listen)


def rows(folder):
    return {row.trial_id: row.digest for row in read_journal(folder / "journal.jsonl").rows}


def case(template, work, verb, act):
    """Return how one verb ended, on a copy of the template."""
    folder = work / "run"
    shutil.copytree(template, folder)
    out, err = work / "out", work / "err"
    code = in_a_fork(lambda: act(folder), out, err)
    told = {
        "verb": verb,
        "code": code,
        "out": out.read_text(),
        "err": err.read_text(),
        "has_verdict": (folder / "report.md").exists(),
        "rows": rows(folder),
    }
    shutil.rmtree(folder)
    return told


def cases(template, work, verb, count, seed, elsewhere):
    seen = work / "seen.json"
    yield case(template, work, verb, lambda folder: record(verb, folder, seen))
    found = json.loads(seen.read_text())
    for name in found["modules"]:
        with suppress(ImportError):  # Modules that made themselves.
            importlib.import_module(name)
    sites = [each for each in found["sites"] if Path(each).parts[0] not in elsewhere]
    plan = [(where, kind) for where in sites for kind in ERRORS]
    for where, kind in random.Random(seed).sample(plan, count or len(plan)):
        told = case(
            template,
            work,
            verb,
            lambda folder, at=where, what=kind: raise_at(verb, folder, at, ERRORS[what]()),
        )
        yield {"site": where, "kind": kind, **told}


if __name__ == "__main__":
    paths, (verb, count, seed, *elsewhere) = map(Path, sys.argv[1:3]), sys.argv[3:]
    for told in cases(*paths, verb, int(count), int(seed), elsewhere):
        print(json.dumps(told), flush=True)
