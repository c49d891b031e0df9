"""The undisturbed runs, each computed once, and the policies that misbehave when a case asks."""

import gc
import importlib.util
import io
import random
import shutil
import sys
import time
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from case import Case
from injection import site

from nw_base.files.cache import cache_dir
from nw_eval.cli import main
from nw_gate.results.provenance import read_run_info
from nw_gate.results.row import rows_digest

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: {policy}
trials: {trials}
seed: 7
episode: {{duration: 0.2}}
scenes: [flat/carpet_room]
record: {record}
gate: {{success_rate: 0.9}}
"""
TRIALS = 6
VERDICT = 1  # REGRESSED: nobody gets anywhere in a fifth of a second.
# What a policy does at its next step is in a file of its folder, once.
OBEYS = """\
import ctypes, os, signal, subprocess, sys, time

from pathlib import Path

class Policy:
    def __init__(self, bundle):
        pass

    def act(self, observation):
        return [0.0] * 12

class Wrap:  # Beside the world, where there is no fence.
    def __init__(self):
        name = f"order-{os.environ['NW_EVAL_RANDOM_FAULT']}"
        self.order = Path(__file__).with_name(name)

    def __call__(self, sample, shot):
        if shot.moment is not None:
            time.sleep(0.02)
            try:
                taken = self.order.rename(self.order.with_suffix(".taken"))
            except OSError:
                return sample
            exec(taken.read_text())
        return sample
"""


@dataclass(frozen=True)
class Origin:
    """An undisturbed run: its command line, its rows, and how long it took."""

    name: str
    work: Path
    words: tuple
    digest: str
    seconds: float

    @property
    def cache(self):
        return self.work / "cache" if self.name in _CACHES else None

    @property
    def cache_gb(self):
        return _CACHES.get(self.name, 0)

    def order(self, case):
        """Return the file from which the sensor of a case takes its order."""
        return self.work.parent / "obeying" / f"order-{case.mark}"

    @cached_property
    def sites(self):
        """The calls of this program's own code while a half of the run is resumed, in order."""
        case = Case(work=self.work / "noted", draw=random.Random(0))
        shutil.copytree(self.work / "run", case.folder)
        lines = case.journal.read_bytes().splitlines(keepends=True)
        case.journal.write_bytes(b"".join(lines[: 1 + TRIALS // 2]))
        case.start(
            "--resume", case.folder, *self.resumed, before=lambda: _note(case.work / "sites")
        )
        assert case.run.end() == VERDICT, case.run.said
        return list(dict.fromkeys((case.work / "sites").read_text().splitlines()))

    @property
    def resumed(self):
        """Words to finish any run of it with: one process is enough."""
        leave = ("--allow-code",) if self.name == "obeying" else ()
        return (*leave, *(("--workers", 2) if self.name in _CACHES else ("--in-process",)))


# By name: the policy, the record, and further words. `alone` is without workers.
_KINDS = {
    "alone": ("stand", "none", ("--in-process",)),
    "workers": ("stand", "none", ("--workers", 2)),
    "network": ("slow", "none", ("--workers", 2)),
    "obeying": ("obeying", "none", ("--workers", 1, "--allow-code")),
    "rendered": ("stand", "all", ("--workers", 2)),
    "cached": ("stand", "none", ("--workers", 2)),
}
# GB of trials in the caches of those that have one of their own.
_CACHES = {"rendered": 0, "cached": 1}


class Origins:
    """Undisturbed runs by name, each run when it is first asked for."""

    def __init__(self, work):
        self._work = work
        self._runs = {}
        bundles = _bundles()
        bundles.write_bundle(work / "slow", "slow")
        (work / "obeying").mkdir()
        wrapped = ", wrap: [{wrapper: 'obeying:Wrap'}]"
        (work / "obeying" / "policy.yaml").write_text(
            bundles.PYTHON_CARD.format(name="obeying", wrapped=wrapped)
        )
        (work / "obeying" / "obeying.py").write_text(OBEYS)

    def __getitem__(self, name):
        return self._runs[name]

    def compute(self, names):
        """Run them in peace; those in which calls raise also for the list of calls."""
        for name in sorted(names):
            self._runs[name] = self._undisturbed(name)
            if name == "alone":
                _ = self._runs[name].sites

    def _path(self, policy):
        folder = self._work / policy
        return folder if folder.exists() else policy

    def _undisturbed(self, name):
        policy, record, words = _KINDS[name]
        work = self._work / f"origin-{name}"
        case = Case(work=work, draw=random.Random(0), cache_gb=_CACHES.get(name, 0))
        (work / "suite.yaml").write_text(
            SUITE.format(policy=self._path(policy), record=record, trials=TRIALS)
        )
        words = (work / "suite.yaml", *words)
        cache = work / "cache" if name in _CACHES else None
        if cache is not None:
            if record != "none":
                # Compiling takes longer than all else; take kernels that are compiled already.
                shutil.copytree(cache_dir("kernels"), cache / "kernels")
            case.start(*words, "--out", work / "first", cache=cache).end()
        began = time.monotonic()
        code = case.start(*words, "--out", case.folder, cache=cache).end()
        assert code == VERDICT, (code, case.run.said)
        digest = rows_digest(case.rows().values())
        if cache is not None:
            assert digest == read_run_info(work / "first" / "run.json").rows_digest
        return Origin(
            name=name,
            work=work,
            words=words,
            digest=digest,
            seconds=time.monotonic() - began,
        )


def _note(file):
    """Write every call site down, from now on."""
    stream, seen = file.open("w", buffering=1), set()

    def listen(frame, event, _):
        if event == "call" and (found := site(frame)) is not None and found not in seen:
            seen.add(found)
            stream.write(f"{found}\n")

    sys.setprofile(listen)


def run_once(work):
    """Run a trial in this process: its forks import and look up nothing that all runs do."""
    suite = work / "first.yaml"
    suite.write_text(SUITE.format(policy="stand", record="none", trials=1))
    words = ["run", str(suite), "--out", str(work / "first"), "--in-process"]
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), suppress(SystemExit):
        main(words)
    gc.collect()
    gc.freeze()  # A fork that looked for garbage would copy every page.


def _bundles():
    place = Path(__file__).parents[1] / "conftest.py"
    spec = importlib.util.spec_from_file_location("bundles", place)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
