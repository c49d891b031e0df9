"""Whatever call raises, whatever it raises: no false verdict, no traceback, no lost row.

The calls are those of api, engine, results, reporting and gate, in the process of the command line,
while it finishes an interrupted run, and while it judges a finished one. All of them are tried at
night; by day some are among the random faults (`random/`).
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from nw_eval import api
from nw_gate.results.journal import read_journal

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: stand
trials: 2
seed: 7
episode: {duration: 0.1}
scenes: [flat/carpet_room]
record: none
gate: {success_rate: 0.9}
"""
REGRESSED = 1
# Usage, a fault: what an error may be. A verdict or an interruption it is not.
ERRORS = {2, 4}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Return the folders of an interrupted run of two trials, and of the same run when finished."""
    folder = tmp_path_factory.mktemp("injection")
    (folder / "suite.yaml").write_text(SUITE)
    whole, cut = folder / "whole", folder / "cut"
    assert api.run(folder / "suite.yaml", out=whole, workers=1).exit_code == REGRESSED
    (whole / "report.md").unlink()
    shutil.copytree(whole, cut)
    (cut / "trials.parquet").unlink()
    header, row, _ = (cut / "journal.jsonl").read_text().splitlines(keepends=True)
    (cut / "journal.jsonl").write_text(header + row)
    return {"run": cut, "report": whole}


def inject(runs, tmp_path, verb, count, seed, *elsewhere):
    """Return what the cases came to, and what the verb comes to undisturbed."""
    script = Path(__file__).with_name("injection.py")
    words = [runs[verb], tmp_path, verb, count, seed, *elsewhere]
    done = subprocess.run(
        [sys.executable, str(script), *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1", "TMPDIR": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    undisturbed, *cases = map(json.loads, done.stdout.splitlines())
    assert (undisturbed["code"], undisturbed["has_verdict"]) == (REGRESSED, True)
    assert cases
    return undisturbed, cases


def faults_of(undisturbed, case, before):
    """Return what is wrong with how a case ended."""
    told = [line for line in case["err"].splitlines() if line.startswith("error: ")]
    is_judged = case["code"] == undisturbed["code"]
    rules = {
        "a code that is neither the verdict's nor an error's": is_judged or case["code"] in ERRORS,
        "a verdict that is not written": case["has_verdict"] or not is_judged,
        "a verdict on other rows": case["rows"] == undisturbed["rows"] or not is_judged,
        "a lost row": before.items() <= case["rows"].items(),
        "a traceback on a screen": "Traceback" not in case["out"] + case["err"],
        "not one line": len(told) == (0 if is_judged else 1),
    }
    return [f"{case['site']}, {case['kind']}: {name}" for name, holds in rules.items() if not holds]


def check(runs, tmp_path, verb, count, seed, *elsewhere):
    undisturbed, cases = inject(runs, tmp_path, verb, count, seed, *elsewhere)
    rows = read_journal(runs[verb] / "journal.jsonl").rows
    before = {row.trial_id: row.digest for row in rows}
    found = [fault for case in cases for fault in faults_of(undisturbed, case, before)]
    codes = [case["code"] for case in cases]
    print(f"{verb}: {len(cases)} cases, codes", {code: codes.count(code) for code in set(codes)})
    assert found == []
    assert set(codes) & ERRORS, "nothing was hit"


@pytest.mark.nightly
@pytest.mark.timeout(4 * 3600)
@pytest.mark.parametrize(
    "elsewhere",
    [("reporting",), ("api", "engine", "results", "gate")],
    ids=["of rows and verdict", "of pages"],
)
def test_every_call_of_the_judgement_raises(runs, tmp_path, elsewhere):
    check(runs, tmp_path, "report", 0, 0, *elsewhere)


@pytest.mark.nightly
@pytest.mark.timeout(4 * 3600)
def test_every_call_of_a_run_raises(runs, tmp_path):
    check(runs, tmp_path, "run", 0, 0, "reporting", "gate")
