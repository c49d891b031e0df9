"""Runs one reader on many mutated files, each in a forked process under watch.

    python tests/fuzz/arena.py TARGET --inputs 200 --seed 1

Prints one JSON object: how many inputs were accepted and refused, and every finding. A finding is
an exception that is none of ours, an error that does not name the file, a process that died, more
than 1.5 GB or 30 s, a forbidden act (a program started, a socket, code imported from beside the
input, something unpickled), a file written outside, or damaged results taken for good ones.
"""

import argparse
import contextlib
import json
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

SECONDS = 30.0
BYTES = 1_500_000_000
_FORBIDDEN = (
    "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.forkpty", "subprocess.Popen",
    "pty.spawn", "socket.connect", "socket.bind", "pickle.find_class",
    "ctypes.dlopen", "shutil.rmtree",
)  # fmt: skip


def watch(here, allowed):
    """Report forbidden acts of Python code from now on, in the list that is returned."""
    seen = []
    roots = tuple(str(path) for path in allowed)

    def hook(event, arguments):
        if event in _FORBIDDEN:
            seen.append(f"{event} {arguments!r:.200}")
        elif event == "exec" and getattr(arguments[0], "co_filename", "").startswith(here):
            seen.append(f"import of {arguments[0].co_filename}")
        elif event == "open" and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"):
            path = (
                os.path.realpath(os.fsdecode(arguments[0]))
                if isinstance(arguments[0], (str, bytes))
                else ""
            )
            if path and not path.startswith(roots) and not path.startswith("/dev/"):
                seen.append(f"open {path} for writing")

    sys.addaudithook(hook)
    return seen


def attempt(target, folder, allowed):
    """Read the input of a folder; return ("accepted" | "refused" | "finding", text)."""
    from nw_base.errors import NwEvalError

    seen = watch(str(folder), (folder, *allowed))
    try:
        said = target.read(folder)
        found = ("accepted", "" if said is None else str(said))
    except NwEvalError as error:
        text = str(error)
        named = any(name in text for name in (*target.names(folder), folder.name))
        found = ("refused", text) if named else ("finding", f"does not name the file: {text}")
        lines = text.count("\n") + 1
        if "\n" in text and lines > 1 and not target.lists:
            found = ("finding", f"{lines} lines: {text[:300]!r}")
        if any(ord(c) < 32 and c != "\n" for c in text):
            found = ("finding", f"control characters in {text[:300]!r}")
        if len(text) > 20_000:
            found = ("finding", f"a message of {len(text)} characters: {text[:200]!r}")
    except BaseException as error:  # noqa: BLE001 - that is what is looked for.
        frames = traceback.extract_tb(error.__traceback__)
        where = " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in frames[-1:-4:-1])
        found = ("finding", f"{type(error).__name__}: {str(error)[:200]} at {where}")
    acts = [act for act in seen if not act.startswith(target.may)]
    return ("finding", "; ".join(acts)) if acts else found


def forked(target, folder, allowed):
    """Run `attempt` in a forked process; return its answer, seconds and largest memory."""
    receiver, sender = os.pipe()
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        _be_the_child(target, folder, allowed, receiver, sender)
    os.close(sender)
    answer, late = _receive(receiver, began + SECONDS)
    if late:
        os.kill(child, signal.SIGKILL)
    _, status, usage = os.wait4(child, 0)
    if late:
        answer = ("finding", f"no answer within {SECONDS:g} s")
    elif answer is None:
        answer = ("finding", f"the process died with status {status}")
    memory = usage.ru_maxrss * 1024
    if memory > BYTES:
        answer = ("finding", f"took {memory / 1e9:.1f} GB; {answer[0]}: {answer[1][:200]}")
    return answer, time.monotonic() - began, memory


def _be_the_child(target, folder, allowed, receiver, sender):
    with contextlib.suppress(BaseException):
        os.close(receiver)
        null = os.open(os.devnull, os.O_RDWR)
        for number in (0, 1, 2):
            os.dup2(null, number)
        os.chdir(folder)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (int(SECONDS) + 5, int(SECONDS) + 5))
        # Past what is allowed, so that it is measured, and not past what the machine has.
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + 2 * BYTES, used + 2 * BYTES))
        os.write(sender, json.dumps(attempt(target, folder, allowed)).encode())
    os._exit(0)


def _receive(receiver, until):
    data = b""
    with os.fdopen(receiver, "rb", buffering=0) as pipe:
        while True:
            ready, _, _ = select.select([pipe], [], [], max(0.0, until - time.monotonic()))
            if not ready:
                return None, True
            part = pipe.read(2**20)
            if not part:
                break
            data += part
    try:
        return tuple(json.loads(data)), False
    except ValueError:
        return None, False


def _mutations(target, seeds, seed, numbers):
    """Yield mutated seeds, each by a generator of its own."""
    import numpy as np
    from mutate import mutate

    for number in numbers:
        rng = np.random.Generator(np.random.PCG64([seed, number]))
        files = dict(seeds[int(rng.integers(len(seeds)))])
        names = [name for name in sorted(files) if target.mutable(name)]
        for _ in range(1 if rng.random() < 0.8 else 2):
            name = names[int(rng.integers(len(names)))]
            files[name] = mutate(files[name], rng, name)
        yield number, files


def _kept(cases, seeds):
    """Yield the findings of a folder: each a file or folder that replaces its like in a seed."""
    for number, case in enumerate(sorted(cases.iterdir())):
        paths = [path for path in case.rglob("*") if path.is_file()] if case.is_dir() else [case]
        mine = {
            str(path.relative_to(case)) if case.is_dir() else path.name: path.read_bytes()
            for path in paths
        }
        alike = [files for files in seeds if set(mine) <= set(files)]
        yield number, {**(alike[0] if alike else {}), **mine}


def run(target, *, inputs=0, seed=1, keep=None, first=0, cases=None):
    """Fuzz one target, or run it on kept cases; return the tally."""
    world = Path(tempfile.mkdtemp(prefix="nw-fuzz-"))
    tally = {"target": target.name, "inputs": 0, "accepted": 0, "refused": 0, "findings": [],
             "seconds": 0.0, "gigabytes": 0.0}  # fmt: skip
    try:
        lend_kernels(world / "cache")
        os.environ["NW_EVAL_CACHE"] = str(world / "cache")
        os.environ["HOME"] = str(world)
        (world / "canary").write_text("untouched")
        seeds = target.seeds(world / "seeds")
        target.warm(seeds)
        before = _listing(world)
        if cases is None:
            drawn = _mutations(target, seeds, seed, range(first, first + inputs))
        else:
            drawn = _kept(cases, seeds)
        for number, files in drawn:
            folder = world / "seeds" / f"input-{number}"
            for name, content in files.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(content)
            (word, text), seconds, memory = forked(target, folder, (world / "cache",))
            tally["inputs"] += 1
            if seconds > tally["seconds"]:
                tally["seconds"], tally["slowest"] = round(seconds, 2), number
            tally["gigabytes"] = max(tally["gigabytes"], round(memory / 1e9, 2))
            if word == "finding":
                tally["findings"].append({"number": number, "what": text[:600]})
                if keep is not None:
                    shutil.copytree(
                        folder, keep / f"{target.name}-{seed}-{number}", dirs_exist_ok=True
                    )
            else:
                tally[word] += 1
            shutil.rmtree(folder, ignore_errors=True)
        if (changed := _listing(world)) != before:
            tally["findings"].append({"number": -1, "what": f"left behind: {changed ^ before}"})
    finally:
        shutil.rmtree(world, ignore_errors=True)
    return tally


def lend_kernels(cache):
    """Begin a cache with the kernels that the user's has: they are none of what is tested."""
    from nw_base.files.cache import private_dir

    shutil.copytree(private_dir("kernels"), cache / "kernels")


def _listing(world):
    """What lies in the world outside the cache, with the content of small files."""
    found = set()
    for path in world.rglob("*"):
        if path.is_file() and not path.is_relative_to(world / "cache"):
            found.add((str(path.relative_to(world)), path.read_bytes()[:1000]))
    return frozenset(found)


def main():
    """Fuzz one target and print its tally."""
    from targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", choices=sorted(TARGETS))
    parser.add_argument("--inputs", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--cases", type=Path)
    given = parser.parse_args()
    told = run(
        TARGETS[given.target], inputs=given.inputs, seed=given.seed, keep=given.keep,
        first=given.first, cases=given.cases,
    )  # fmt: skip
    print(json.dumps(told))


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
