"""Random faults at random moments of real runs, each resumed until it is done, and a tally.

    python random_faults.py COUNT [SEED [FIRST]]

A case is a run of four short trials by two workers that is hit once. It must end with the code that
its fault deserves, without a traceback and without leaving a process, and be resumed to the rows
and the verdict of the undisturbed run. Prints one line for each case and a table at the end.
"""

import importlib.util
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from nw_eval.errors import NwEvalError
from nw_eval.files.cache import cache_dir
from nw_eval.results.journal import read_journal
from nw_eval.results.row import rows_digest

NW_EVAL = [sys.executable, "-c", "from nw_eval.cli import main; main()"]
SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: {policy}
trials: 4
seed: 7
episode: {{duration: 0.2}}
scenes: [flat/carpet_room]
record: {record}
gate: {{success_rate: 0.9}}
"""
VERDICT = 1  # REGRESSED: nobody gets anywhere in a fifth of a second.
FAULT, INTERRUPTED = 4, 130
KILLED = -signal.SIGKILL
LONGEST = 300.0  # s that a run may take here, resumed or not
MARK = "NW_EVAL_RANDOM_FAULT"


@dataclass
class Case:
    """One run that is being hit."""

    work: Path
    draw: random.Random
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)
    process: subprocess.Popen | None = None

    @property
    def folder(self):
        return self.work / "run"

    @property
    def journal(self):
        return self.folder / "journal.jsonl"

    @property
    def cache(self):
        return self.work / "cache"

    def start(self, *words, limit=None):
        """Start nw-eval in a group of its own, as a terminal does.

        A limit in bytes for every file is a disk that fills up.
        """
        self.process = subprocess.Popen(
            [*NW_EVAL, "run", *words, "--workers", "2"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env={
                **os.environ,
                "NW_EVAL_CACHE": str(self.cache),
                "TMPDIR": str(self.work / "tmp"),
                MARK: self.mark,
            },
        )
        if limit is not None:
            resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (limit, limit))

    def wait_until(self, holds):
        """Wait until something holds or the process has ended."""
        deadline = time.monotonic() + LONGEST
        while self.process.poll() is None and not holds() and time.monotonic() < deadline:
            time.sleep(0.002)

    def end(self):
        """Wait for the end; return code and output."""
        try:
            out, err = self.process.communicate(timeout=LONGEST)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            out, err = self.process.communicate()
            return None, out, err
        return self.process.returncode, out, err

    def parent(self):
        """Return the process that was started, or none once its number may be another's."""
        return [self.process.pid] if self.process.poll() is None else []

    def rows(self):
        try:
            return {row.trial_id: row for row in read_journal(self.journal).rows}
        except NwEvalError:
            return {}

    def relatives(self):
        """Return every process that has this case's mark, the first one included."""
        wanted = f"{MARK}={self.mark}".encode()
        found = []
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    if wanted in (entry / "environ").read_bytes():
                        found.append(int(entry.name))
                except OSError:
                    continue
        return found

    def workers(self):
        found = []
        for pid in self.relatives():
            try:
                if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes():
                    found.append(pid)
            except OSError:
                continue
        return sorted(found)

    def listens(self):
        """Whether the process has come to its own first line: it then handles SIGTERM."""
        try:
            lines = Path(f"/proc/{self.process.pid}/status").read_text().splitlines()
        except OSError:
            return False
        masks = [line.split()[1] for line in lines if line.startswith("SigCgt")]
        return any(int(mask, 16) >> (signal.SIGTERM - 1) & 1 for mask in masks)

    def sleep(self, longest):
        time.sleep(self.draw.random() * longest)


def send(pids, number, *, to_group=False):
    """Send a signal to processes, or to the groups that they lead, if they are still there."""
    for pid in pids:
        try:
            (os.killpg if to_group else os.kill)(pid, number)
        except ProcessLookupError:
            continue


def hit_parent(number, *, to_group, longest=4.0):
    """Send a signal to the process, or to its group, at any moment from its first line on."""

    def hit(case):
        case.wait_until(case.listens)
        case.sleep(longest)
        send(case.parent(), number, to_group=to_group)

    return hit


def hit_workers(number, *, every):
    """Send a signal to one worker, or to all, while trials run."""

    def hit(case):
        case.wait_until(case.journal.exists)
        case.sleep(3.0)
        found = case.workers()
        send(found if every else case.draw.sample(found, min(1, len(found))), number)

    return hit


def stop_for_a_while(whom):
    def hit(case):
        case.wait_until(case.journal.exists if whom == "workers" else case.listens)
        case.sleep(3.0)
        pids = case.workers() if whom == "workers" else case.parent()
        send(pids, signal.SIGSTOP, to_group=whom == "group")
        case.sleep(1.5)
        send(pids, signal.SIGCONT, to_group=whom == "group")  # None has ended: they were stopped.

    return hit


def tear_the_journal(case):
    """Kill everything, and cut off a part of the last line, as a lost power supply may."""
    case.wait_until(lambda: case.journal.exists() and case.journal.read_bytes().count(b"\n") > 1)
    case.sleep(1.0)
    send(case.parent(), signal.SIGKILL, to_group=True)
    case.process.wait()
    if case.journal.exists():
        data = case.journal.read_bytes()
        last = data.splitlines(keepends=True)[-1]
        case.journal.write_bytes(data[: len(data) - case.draw.randrange(len(last))])


def remove_the_folder(case):
    case.wait_until(case.journal.exists)
    case.sleep(3.0)
    if case.process.poll() is None:
        case.folder.rename(case.work / "removed")


def remove_the_cache(case):
    case.wait_until(case.listens)
    case.sleep(4.0)
    shutil.rmtree(case.cache / "scenes", ignore_errors=True)


def nothing_more(_):
    """Do nothing: the disk is full from the beginning."""


# What hits a run, and the codes that are true then. A fault may come after the end: a verdict is
# true always.
FAULTS = {
    "SIGKILL parent": (hit_parent(signal.SIGKILL, to_group=False), {KILLED}),
    "SIGKILL group": (hit_parent(signal.SIGKILL, to_group=True), {KILLED}),
    "SIGTERM parent": (hit_parent(signal.SIGTERM, to_group=False), {INTERRUPTED}),
    "SIGTERM group": (hit_parent(signal.SIGTERM, to_group=True), {INTERRUPTED}),
    "SIGINT parent": (hit_parent(signal.SIGINT, to_group=False), {INTERRUPTED}),
    "SIGINT group": (hit_parent(signal.SIGINT, to_group=True), {INTERRUPTED}),
    "SIGKILL a worker": (hit_workers(signal.SIGKILL, every=False), set()),
    "SIGKILL all workers": (hit_workers(signal.SIGKILL, every=True), set()),
    "SIGTERM a worker": (hit_workers(signal.SIGTERM, every=False), set()),
    "SIGSEGV a worker": (hit_workers(signal.SIGSEGV, every=False), set()),
    "SIGABRT all workers": (hit_workers(signal.SIGABRT, every=True), set()),
    "SIGSTOP parent": (stop_for_a_while("parent"), set()),
    "SIGSTOP group": (stop_for_a_while("group"), set()),
    "SIGSTOP workers": (stop_for_a_while("workers"), set()),
    "torn journal": (tear_the_journal, {KILLED}),
    "full disk": (nothing_more, {FAULT}),
    "removed folder": (remove_the_folder, {FAULT}),
    "removed cache": (remove_the_cache, set()),
}


def record_of(kind):
    """Return whose images a run records: only a run that renders uses what is cached."""
    return "all" if kind == "removed cache" else "none"


def prepare(work, records):
    """Write the policy and, for logs without and with images, a suite; fill its cache."""
    spec = importlib.util.spec_from_file_location(
        "bundles", Path(__file__).with_name("conftest.py")
    )
    bundles = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bundles)
    policy = bundles.write_bundle(work / "policy", "slow")
    return {record: undisturbed(work / record, policy, record) for record in records}


def undisturbed(work, policy, record):
    """Run a suite in peace; return its folder, and the digest of its rows."""
    (work / "tmp").mkdir(parents=True)
    (work / "suite.yaml").write_text(SUITE.format(policy=policy, record=record))
    case = Case(work=work, draw=random.Random(0))
    # Compiling takes longer than all else; where kernels are compiled already, they are taken.
    shutil.copytree(cache_dir("kernels"), case.cache / "kernels")
    case.start(str(work / "suite.yaml"), "--out", str(case.folder))
    code, out, err = case.end()
    assert code == VERDICT, (code, out, err)
    return work, rows_digest(case.rows().values())


def play(origin, digest, kind, seed):
    """Hit one run, resume it until it is done; return its first code and what was wrong."""
    with tempfile.TemporaryDirectory(dir=origin) as name:
        case = Case(work=Path(name), draw=random.Random(seed))
        (case.work / "tmp").mkdir()
        shutil.copytree(origin / "cache", case.cache)
        hit, true_codes = FAULTS[kind]
        limit = case.draw.randrange(1_000, 20_000) if kind == "full disk" else None
        begin = (str(origin / "suite.yaml"), "--out", str(case.folder))
        case.start(*begin, limit=limit)
        hit(case)
        first, out, err = code, *_ = case.end()
        wrong = [] if first in {*true_codes, VERDICT} else [f"code {first}: {err[-400:]}"]
        said = out + err
        kept = case.rows()
        for _ in range(3):
            if code == VERDICT and case.folder.exists():
                break
            # Killed before anything was kept, or its folder removed: it begins again.
            is_kept = case.journal.exists()
            case.start(*(("--resume", str(case.folder)) if is_kept else begin))
            code, out, err = case.end()
            said += out + err
        if code != VERDICT:
            wrong.append(f"resumed to {code}: {err[-400:]}")
        rows = case.rows()
        if rows_digest(rows.values()) != digest:
            wrong.append("other rows")
        if any(row.status == "ok" and rows.get(name) != row for name, row in kept.items()):
            wrong.append("a finished trial was lost")
        if "Traceback" in said:
            wrong.append(f"a traceback: {said[-1500:]}")
        deadline = time.monotonic() + 10.0
        while (left := case.relatives()) and time.monotonic() < deadline:
            time.sleep(0.05)
        if left:
            wrong.append(f"{len(left)} processes left")
            send(left, signal.SIGKILL)
    return first, wrong


def main(count, seed=9, first=0):
    """Play cases, every kind in turn; return how many were not as they must be."""
    tally = Counter()
    failed = 0
    with tempfile.TemporaryDirectory(prefix="nw-eval-faults-") as name:
        kinds = random.Random(seed).sample(list(FAULTS), len(FAULTS))
        plan = [(number, kinds[number % len(kinds)]) for number in range(first, first + count)]
        origins = prepare(Path(name), sorted({record_of(kind) for _, kind in plan}))
        for number, kind in plan:
            origin, digest = origins[record_of(kind)]
            code, wrong = play(origin, digest, kind, f"{seed}-{number}")
            tally[kind, code] += 1
            failed += bool(wrong)
            print(f"{number:3} {kind}: {code}", *wrong, sep="; ", flush=True)
    print(f"\n{count} faults, {failed} not as they must be")
    for (kind, code), times in sorted(tally.items(), key=str):
        print(f"{kind:20} ended with {code:4}: {times}")
    return failed


if __name__ == "__main__":
    sys.exit(min(main(*map(int, sys.argv[1:])), 1))
