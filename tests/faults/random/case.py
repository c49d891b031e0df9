"""One run that is being hit: its processes, its folder, and what is left of them."""

import contextlib
import os
import random
import resource
import signal
import sys
import time
import uuid
from dataclasses import dataclass, field
from pathlib import Path

from nw_base.errors import NwEvalError
from nw_eval.cli import main
from nw_gate.results.journal import read_journal

sys.path.append(str(Path(__file__).parents[1]))  # For what lies beside this folder.

LONGEST = 300.0  # s that a run may take here, resumed or not
MARK = "NW_EVAL_RANDOM_FAULT"
SESSION, STATE = 3, 0  # Fields of /proc/PID/stat behind the name.


@dataclass
class Run:
    """One process of nw-eval: forked from this one, which has imported everything."""

    pid: int
    output: Path
    code: int | None = None

    def poll(self):
        if self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
        return self.code

    def end(self):
        """Wait for the end; return the code, or None if it had to be killed."""
        deadline = time.monotonic() + LONGEST
        while self.poll() is None:
            if time.monotonic() > deadline:
                os.killpg(self.pid, signal.SIGKILL)
                os.waitpid(self.pid, 0)
                self.code = -1
                return None
            time.sleep(0.005)
        return self.code

    @property
    def said(self):
        return self.output.read_text(errors="replace")


@dataclass
class Case:
    """A run in a folder of its own, and the draws by which it is hit."""

    work: Path
    draw: random.Random
    longest: float = 4.0  # s that such a run takes undisturbed
    folder: Path = None
    cache_gb: int = 0  # Of trials that may be taken over; what is taken over cannot be hit.
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)
    run: Run | None = None
    runs: list = field(default_factory=list)
    wrong: list = field(default_factory=list)  # Sentences.

    def __post_init__(self):
        self.folder = self.folder or self.work / "run"
        (self.work / "tmp").mkdir(parents=True, exist_ok=True)

    @property
    def journal(self):
        return self.folder / "journal.jsonl"

    def start(self, *words, verb=("run",), cache=None, limit=None, before=None, environment=None):
        """Start nw-eval in a session of its own.

        Args:
            words: of the command line, behind the verb.
            verb: words of it.
            cache: a cache that holds something; an empty one if None.
            limit: bytes that every file may have: a disk that fills up.
            before: called in the new process first.
            environment: beside this process's.
        """
        output = self.work / f"output-{len(self.runs)}"
        environment = (environment or {}) | {
            MARK: self.mark,
            "TMPDIR": str(self.work / "tmp"),
            "NW_EVAL_CACHE_GB": str(self.cache_gb),
            "NW_EVAL_CACHE": str(cache or self.work / "cache"),
        }
        pid = _forked(["nw-eval", *verb, *map(str, words)], environment, output, before)
        if limit is not None:
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (limit, limit))
        self.run = Run(pid=pid, output=output)
        self.runs.append(self.run)
        return self.run

    def wait_until(self, holds, *, every=0.002):
        """Wait until something holds or the run has ended; look so many seconds apart."""
        deadline = time.monotonic() + LONGEST
        while self.run.poll() is None and not holds() and time.monotonic() < deadline:
            time.sleep(every)

    def wait_for_a_moment(self, trials):
        """Wait until a number of trials that is drawn have ended, and a little longer."""
        wanted = self.draw.randrange(trials)
        self.wait_until(lambda: self.lines() > wanted)
        self.sleep(1 / trials)

    def lines(self):
        """Return how many lines the journal has, its header included."""
        try:
            return self.journal.read_bytes().count(b"\n")
        except OSError:
            return 0

    def sleep(self, share):
        """Wait for a part of the time that a run takes, at most a share of it."""
        time.sleep(self.draw.random() * share * self.longest)

    def parent(self):
        """Return the process that was started, or none once its number may be another's."""
        return [self.run.pid] if self.run.poll() is None else []

    def rows(self):
        try:
            return {row.trial_id: row for row in read_journal(self.journal).rows}
        except NwEvalError:
            return {}

    def relatives(self):
        """Return every living process that the case has started, without the one that ends it."""
        wanted = f"{MARK}={self.mark}".encode()
        pids = {run.pid for run in self.runs if run.code is None}
        found = []
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            with contextlib.suppress(OSError):
                fields = stat_of(entry.name)
                is_ours = int(entry.name) in pids or int(fields[SESSION]) in pids
                if is_ours or wanted in (entry / "environ").read_bytes():
                    found += [int(entry.name)] if fields[STATE] != "Z" else []
        return found

    def workers(self):
        """Return the workers: each is the first of a session of its own."""
        pids = {run.pid for run in self.runs}
        found = []
        for pid in self.relatives():
            with contextlib.suppress(OSError):
                if pid not in pids and int(stat_of(pid)[SESSION]) == pid:
                    found.append(pid)
        return sorted(found)

    def listens(self):
        """Whether the process has come to its own first line: it then handles SIGTERM."""
        try:
            lines = Path(f"/proc/{self.run.pid}/status").read_text().splitlines()
        except OSError:
            return False
        masks = [line.split()[1] for line in lines if line.startswith("SigCgt")]
        return any(int(mask, 16) >> (signal.SIGTERM - 1) & 1 for mask in masks)


def stat_of(pid):
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


def send(pids, number, *, to_group=False):
    """Send a signal to processes, or to the groups that they lead, if they are still there."""
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            (os.killpg if to_group else os.kill)(pid, number)


def _forked(words, environment, output, before):
    """Run the command line in a fork of this process, which has imported everything."""
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    code = 99
    try:
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.environ.update(environment)
        handle = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        sys.argv = words
        if before is not None:
            before()
        main()
    except SystemExit as left:
        code = left.code
    finally:
        sys.setprofile(None)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
