"""What hits a run: signals, deeds of its policy, disks, files, and other runs.

Each takes a case and its origin, starts the run, and hits it; some wait for its end.
"""

import shutil
import signal

import disks
from case import send
from injection import ERRORS, raising
from origins import TRIALS

MB = 10**6
REFUSED = 4  # Exit code of a run whose journal another one holds.


def begin(case, origin, *more, **how):
    """Start a case's run."""
    case.start(*origin.words, "--out", case.folder, *more, cache=cache_of(case, origin), **how)


def cache_of(case, origin):
    """Return a case's copy of its origin's cache, where it has one of its own."""
    if origin.cache is None:
        return None
    cache = case.work / "cache"
    if not cache.exists():
        shutil.copytree(origin.cache, cache)
    return cache


def signal_to_parent(number, *, to_group=False):
    """Send a signal to the process, or to its group, at any moment from its first line on."""

    def hit(case, origin):
        begin(case, origin)
        case.wait_until(case.listens)
        if case.draw.random() < 0.3:
            case.sleep(0.3)
        else:
            case.wait_for_a_moment(TRIALS + 1)
        send(case.parent(), number, to_group=to_group)

    return hit


def signal_to_workers(number, *, every):
    """Send a signal to one worker, or to all, while trials run."""

    def hit(case, origin):
        begin(case, origin)
        case.wait_for_a_moment(TRIALS)
        found = case.workers()
        send(found if every else case.draw.sample(found, min(1, len(found))), number)

    return hit


def stopped_for_a_while(whom):
    def hit(case, origin):
        begin(case, origin)
        case.wait_for_a_moment(TRIALS)
        pids = case.workers() if whom == "workers" else case.parent()
        send(pids, signal.SIGSTOP, to_group=whom == "group")
        case.sleep(0.5)
        send(pids, signal.SIGCONT, to_group=whom == "group")  # None has ended: they were stopped.

    return hit


def ordered(deed, *words):
    """Let the policy do something in the midst of a trial, once."""

    def hit(case, origin):
        begin(case, origin, *words)
        wanted = case.draw.randrange(TRIALS // 2)  # Enough are left to hear the order.
        case.wait_until(lambda: case.lines() > wanted)
        draft = case.work / "order"
        draft.write_text(deed)
        draft.rename(origin.order(case))

    return hit


HOARD = f"hoard = [bytearray({10 * MB}) for _ in range(100)]; time.sleep(60)"
HOARDING = f"import time; {HOARD}"
CHILD = f"subprocess.run([sys.executable, '-c', {HOARDING!r}], start_new_session=True)"
LIMIT = ("--memory-limit", "700MB")
STOP = "os.kill(os.getpid(), signal.SIGSTOP)"


def killed(case, origin, *, rows=1):
    """Kill a run as soon as it has some rows."""
    begin(case, origin)
    case.wait_until(lambda: case.lines() > rows)
    send(case.parent(), signal.SIGKILL, to_group=True)
    case.run.end()


def torn_journal(case, origin):
    """Cut a journal at any byte of its last three lines, as a lost power supply may."""
    killed(case, origin, rows=case.draw.randrange(2, 5))
    data = case.journal.read_bytes()
    last = sum(map(len, data.splitlines(keepends=True)[-3:]))
    case.journal.write_bytes(data[: len(data) - case.draw.randrange(1, last + 1)])


def removed_folder(case, origin):
    begin(case, origin)
    case.wait_for_a_moment(TRIALS + 1)
    if case.parent():
        case.folder.rename(case.work / "removed")


def no_longer_files(case, origin):
    """Let no file have more than some bytes: EFBIG where a full disk has ENOSPC."""
    begin(case, origin, limit=case.draw.randrange(1_000, 20_000))


def full_disk(case, origin):
    disks.disk(case.work / "disk", size=4096 * case.draw.randrange(4, 100))
    case.folder = case.work / "disk" / "run"
    try:
        begin(case, origin)
        case.run.end()
    finally:
        disks.enlarge(case.work / "disk")


def write_protected(case, origin):
    """Make the folder read-only in mid-run, and writable again when the run has ended."""
    begin(case, origin)
    case.wait_for_a_moment(TRIALS + 1)
    case.folder.mkdir(exist_ok=True)
    disks.write_protect(case.folder)
    try:
        case.run.end()
    finally:
        disks.release(case.folder)


def write_protected_resume(case, origin):
    killed(case, origin)
    disks.write_protect(case.folder)
    try:
        case.start("--resume", case.folder, *origin.resumed).end()
    finally:
        disks.release(case.folder)


def call_raises(error):
    """Let a call of this program's own code raise, anywhere between a resume and its verdict."""

    def hit(case, origin):
        killed(case, origin, rows=case.draw.randrange(1, TRIALS))
        words = ("--resume", case.folder, *origin.resumed)
        where = case.draw.choice(origin.sites)
        case.start(*words, before=lambda: raising(where, ERRORS[error]()))

    return hit


def two_resumes(case, origin):
    killed(case, origin, rows=case.draw.randrange(3))
    case.folder.mkdir(exist_ok=True)
    first = case.start("--resume", case.folder, *origin.resumed)
    case.sleep(0.1)
    second = case.start("--resume", case.folder, *origin.resumed)
    if {first.end(), second.end()} == {REFUSED}:
        case.wrong.append("each was refused for the other")


def resumed_while_it_runs(case, origin):
    begin(case, origin)
    began = case.run
    case.wait_for_a_moment(TRIALS)
    case.start("--resume", case.folder, *origin.resumed).end()
    began.end()
