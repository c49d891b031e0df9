"""Kills verbs at random moments, gives them again, and compares the end with an undisturbed one.

    python killed.py KILLS [SEED] [--only VERB ...]

A case is a verb that is killed once to three times: its process, its group, or one of its children,
at a moment that is drawn. The same words are given again until it has ended, and then: its exit
code and all files are those of an undisturbed run, but for such as differ between two of those (of
runs, the digest of their rows is compared); no process is left, and nothing takes longer than
`case.LONGEST`. Prints a line for each case, and a table.
"""

import argparse
import hashlib
import importlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import case as cases_of
from aftermath import that_stay
from case import Case, send
from origins import run_once
from verbs import VERBS, copied

from nw_base.files.cache import cache_dir
from nw_gate.results.provenance import read_run_info

KILLED, USAGE = -signal.SIGKILL, 2
WHOM = ("its process", "its group", "a child")
_MOST = 3
cases_of.LONGEST = 1200.0  # A build on a machine that has other things to do.


class Killed:
    """A verb, its inputs, and what two undisturbed runs of it left."""

    def __init__(self, name, work):
        self.name, self.verb, self.work = name, VERBS[name], work
        self.inputs = work / "inputs"
        self.inputs.mkdir(parents=True)
        maker = Case(work=self.inputs, draw=random.Random(0))
        self.verb.inputs(self.inputs, lambda *words: self._made(maker, words))
        began = time.monotonic()
        self.files = self._undisturbed("first")
        self.seconds = time.monotonic() - began
        again = self._undisturbed("second")
        self.moving = {path for path in self.files if self.files[path] != again.get(path)}

    def start(self, case, words=None):
        verb, *rest = words or self.verb.words or ("none",)
        deed = self.verb.deed

        def before():
            os.chdir(case.folder)
            if deed is not None:
                deed()
            if self.verb.imports is None:  # A library in it has threads, which no fork has.
                words = [verb, *map(str, rest)]
                os.execv(sys.executable, [sys.executable, "-m", "nw_eval", *words])

        if not (cache := case.work / "cache").exists():
            shutil.copytree(cache_dir("kernels"), cache / "kernels")
        return case.start(*rest, verb=(verb,), before=before)

    def case(self, name, seed):
        folder = copied(self.inputs, self.work / name / "place")
        return Case(work=self.work / name, draw=random.Random(seed), folder=folder)

    def play(self, case, most):
        """Kill it up to so many times and let it end; return how often, and what is wrong."""
        kills, wrong = Counter(), []
        for _ in range(case.draw.randint(1, min(_MOST, most))):
            run = self._go_on(case)
            deadline = time.monotonic() + case.draw.random() * self.seconds
            while run.poll() is None and time.monotonic() < deadline:
                time.sleep(0.001)
            whom = case.draw.choice(WHOM)
            children = [pid for pid in case.relatives() if pid != run.pid]
            if run.poll() is not None:
                break
            hit = case.draw.choice(children) if whom == WHOM[2] and children else run.pid
            send([hit], signal.SIGKILL, to_group=whom == WHOM[1])
            kills[whom if hit != run.pid or whom == WHOM[1] else WHOM[0]] += 1
            code = run.end()
            if code not in {KILLED, self.verb.code, 2, 4, 5} or "Traceback" in run.said:
                wrong.append(f"code {code}: {run.said[-300:]}")
            wrong += self._halves(case.folder)
        run = self._go_on(case)
        if run.end() == USAGE and "--resume" in run.said:
            run = self._go_on(case)
        if (code := run.end()) is None:
            wrong.append("it hung")
        elif code != self.verb.code:
            wrong.append(f"ended with {code}: {run.said[-400:]}")
        else:
            wrong += self._differences(case.folder)
        if left := that_stay(case.relatives):
            wrong.append(f"{len(left)} processes left")
            send(left, signal.SIGKILL)
        return kills, wrong

    def _go_on(self, case):
        """Start it, by the words to resume with once it has said that these are wanted."""
        if case.runs and self.verb.resume and "--resume" in case.run.said:
            return self.start(case, self.verb.resume)
        return self.start(case)

    def _made(self, maker, words):
        verb, *rest = map(str, words)
        code = maker.start(*rest, verb=(verb,), before=lambda: os.chdir(self.inputs)).end()
        assert code in {0, 1}, maker.run.said

    def _undisturbed(self, name):
        case = self.case(name, 0)
        code = self.start(case).end()
        assert code == self.verb.code, (self.name, code, case.run.said)
        return _files(case.folder)

    def _differences(self, folder):
        found = _files(folder)
        yield from (f"{path} is missing" for path in sorted(self.files.keys() - found.keys()))
        for path in sorted(self.files.keys() & found.keys() - self.moving):
            if self.files[path] != found[path]:
                yield f"{path} is another"
        yield from (f"{path} is left" for path in sorted(found.keys() - self.files.keys()))

    def _halves(self, folder):
        """Name files that are cut, although they have the name of a whole one."""
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if name in self.files and path.suffix in {".json", ".parquet"}:
                try:
                    _parse(path)
                except Exception as error:  # noqa: BLE001 - whatever a reader says.
                    yield f"half of {name}: {error}"


def _parse(path):
    import pyarrow.parquet

    if path.suffix == ".parquet":
        pyarrow.parquet.read_table(path)
    else:
        json.loads(path.read_bytes())


def _files(folder):
    """Return what lies in a folder: digests of files, and of runs those of their rows."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file():
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        if path.name == "run.json":
            found[f"rows of {name}"] = read_run_info(path).rows_digest
    return found


def main():
    """Kill, and return 1 if anything was lost."""
    parser = argparse.ArgumentParser()
    parser.add_argument("kills", type=int, help="of each verb")
    parser.add_argument("seed", type=int, nargs="?", default=9)
    parser.add_argument("--only", nargs="*", default=list(VERBS), choices=list(VERBS))
    asked = parser.parse_args()
    lines, failed = [], 0
    with tempfile.TemporaryDirectory(prefix="nw-eval-killed-", ignore_cleanup_errors=True) as place:
        run_once(Path(place))
        for name in asked.only:
            for module in VERBS[name].imports or ():
                importlib.import_module(module)
            killed = Killed(name, Path(place) / name.replace(" ", "-"))
            total, cases, faulty = Counter(), 0, 0
            while total.total() < asked.kills:
                case = killed.case(f"case-{cases}", f"{asked.seed}-{name}-{cases}")
                kills, wrong = killed.play(case, asked.kills - total.total())
                codes = [run.code for run in case.runs]
                print(f"{name} {cases}: {dict(kills)}, codes {codes}", *wrong, sep="; ", flush=True)
                total, cases, faulty = total + kills, cases + 1, faulty + bool(wrong)
                shutil.rmtree(case.work, ignore_errors=True)
            failed += faulty
            lines.append(
                f"| {name} | {total.total()} | " + " | ".join(str(total[whom]) for whom in WHOM)
                + f" | {cases} | {killed.seconds:.1f} | {faulty} |"
            )  # fmt: skip
    print("\n| verb | kills | " + " | ".join(WHOM) + " | runs | s undisturbed | faulty |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|", *lines, sep="\n")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
