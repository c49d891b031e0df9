"""`nw-eval run --engine ray`: rows and logs of the local engine, whatever becomes of the nodes."""

import hashlib
import os
import shutil
import signal
import socket
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from nw_eval import api
from nw_gate.results.baseline_file import baseline_of_run, write_baseline
from nw_gate.results.journal import read_journal
from nw_gate.results.provenance import read_run_info
from nw_gate.results.row import rows_digest

pytest.importorskip("ray", reason="the extra `ray` is not installed")

POLICY = Path(__file__).parents[4] / "policies" / "stand"


def contents(folder):
    """What a run came to: the digest of its rows, and those of its logs by name."""
    logs = {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in (folder / "mcap").rglob("*")
        if path.is_file()
    }
    return read_run_info(folder / "run.json").rows_digest, logs


def ended(process):
    """Wait for a process; return its exit code and what it printed."""
    printed, _ = process.communicate(timeout=280)
    return process.returncode, printed


def journal_lines(folder):
    path = folder / "journal.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def test_a_cluster_of_this_machine_makes_the_rows_and_logs_of_this_process(nw_eval, tiny, tmp_path):
    shutil.copytree(POLICY, tmp_path / "mine")
    here, there, cache = tmp_path / "here", tmp_path / "there", tmp_path / "cache"
    os.environ.pop("RAY_ADDRESS", None)
    api.run(tiny, policy=str(tmp_path / "mine"), out=here, in_process=True)

    code, printed = ended(
        nw_eval(
            *("run", tiny, "--policy", tmp_path / "mine", "--out", there),
            *("--engine", "ray", "--workers", "1"),
            env={"NW_EVAL_CACHE": str(cache), "HOME": str(tmp_path)},
        )
    )

    assert code == 0, printed
    assert contents(there) == contents(here)
    assert len(contents(there)[1]) == 2
    # The policy lies on the node by its content; nothing of Ray's is left, or said.
    (file_bundle,) = [path for path in (cache / "received").iterdir() if path.is_dir()]
    assert (file_bundle / "policy.yaml").read_bytes() == (POLICY / "policy.yaml").read_bytes()
    assert "ray" not in printed.replace("(engine ray)", "").lower().replace("array", "")
    assert not (tmp_path / ".ray").exists()


QUICK = """\
nw-eval: 1
name: quick
robot: go1
policy: go1-parkour
trials: 4
seed: 5
episode: {duration: 4.0}
scenes: [hurdles/one_low_carpet, hurdles/two_logs_park]
record: none
gate:
  {success_rate: 0.05, max_drop: 0.5, tolerate: 0.1, rounds: 4, least_starts: 1, confidence: 0.8}
"""


@pytest.fixture
def gated(tmp_path, monkeypatch):
    """A project with a policy's baselines of this and another machine, and a softer policy."""
    monkeypatch.chdir(tmp_path)
    Path("quick.yaml").write_text(QUICK)
    shutil.copytree(POLICY.with_name("go1-parkour"), "soft")
    card = Path("soft/policy.yaml")
    text = card.read_text().replace("kp: 20", "kp: 19").replace("name: go1-parkour", "name: soft")
    card.write_text(text)
    whole = api.run("quick.yaml", baseline="none", workers=2, out=Path("whole"))
    baseline = baseline_of_run(whole.rows, whole.info, name="here", card="go1-parkour")
    write_baseline(Path("here.parquet"), baseline)
    (panel,), (info,) = baseline.panels, baseline.manifest.panels
    machine = {**panel.machine, "cpu": "elsewhere"}
    starts = tuple(replace(start, trajectory="0" * 16) for start in panel.starts)
    known = baseline.manifest.model_copy(
        update={"name": "other", "panels": (info.model_copy(update={"machine": machine}),)}
    )
    other = replace(
        baseline, manifest=known, panels=(replace(panel, machine=machine, starts=starts),)
    )
    write_baseline(Path("other.parquet"), other)
    return tmp_path


@pytest.mark.nightly
@pytest.mark.parametrize("baseline", ["here", "other"])
def test_a_gate_on_ray_judges_the_rows_of_local_workers_and_ends_with_the_same_trial(
    gated, nw_eval, baseline
):
    os.environ.pop("RAY_ADDRESS", None)
    local = [
        api.run(
            "quick.yaml", policy="./soft", baseline=f"./{baseline}.parquet", workers=workers,
            out=Path(f"local-{workers}"),
        )
        for workers in (1, 2)
    ]  # fmt: skip
    assert 2 <= len(local[0].rows) < 8, "it ends early"
    for workers in (1, 2):
        out = Path(f"ray-{workers}")
        code, printed = ended(
            nw_eval(
                *("run", "quick.yaml", "--policy", "./soft", "--baseline", f"./{baseline}.parquet"),
                *("--out", out, "--engine", "ray", "--workers", workers),
                env={"HOME": str(gated)},
            )
        )
        assert code == 0, printed
        there = api.report(out)
        for here in local:
            assert rows_digest(there.rows) == rows_digest(here.rows)
            assert (there.info.stop, there.verdict) == (here.info.stop, here.verdict)
        assert (there.verdict.verdict, there.info.stop.first) == ("PASS", len(there.rows))
        assert f"decided after {len(there.rows)} of 8 trials; the rest were skipped" in printed
        if baseline == "other":
            assert there.verdict.against.basis == "control"
            assert len(api.read_rows(out / "baseline")) == len(there.rows)


@pytest.mark.nightly
def test_a_raylet_that_is_killed_costs_its_trials_one_retry(cluster, nw_eval, until, tmp_path):
    for _ in range(3):
        cluster.start()
    here, there = tmp_path / "here", tmp_path / "there"
    api.run("smoke", trials=6, out=here, workers=2)

    run = nw_eval(
        *("run", "smoke", "--trials", "6", "--out", there),
        *("--engine", "ray", "--address", cluster.address),
        env=cluster.env,
    )
    try:
        until(lambda: cluster.agent(2) is not None, "workers on the third node")
        until(lambda: journal_lines(there) >= 4, "three trials")
        os.kill(cluster.raylet(2), signal.SIGKILL)
        code, printed = ended(run)
    finally:
        run.kill()

    assert code == 0, printed
    assert contents(there) == contents(here)
    rows = read_journal(there / "journal.jsonl").rows
    attempts = Counter(row.attempt for row in rows)
    assert set(attempts) <= {1, 2}
    # A trial of the node's says it at once; the node itself is missed at the next look.
    assert f"node {socket.gethostname()} " in printed
    assert "was lost; it will run again" in printed
    assert printed.count("it will run again in a fresh process") == attempts[2]


@pytest.mark.nightly
@pytest.mark.parametrize("runtime", ["nw-eval", "native"])
def test_a_node_with_another_processor_is_refused_where_results_depend_on_it(
    cluster, nw_eval, tiny, tmp_path, runtime
):
    """What nw-eval runs itself gives the same results on both."""
    shutil.copytree(POLICY.with_name("go1-parkour"), tmp_path / "mine")
    card = tmp_path / "mine" / "policy.yaml"
    card.write_text(card.read_text() + f"\nruntime: {runtime}\n")
    cluster.start()
    cluster.start(env={"NUMBA_CPU_NAME": "generic"})

    code, printed = ended(
        nw_eval(
            *("run", tiny, "--policy", tmp_path / "mine", "--trials", "8"),
            *("--out", tmp_path / "run", "--engine", "ray", "--address", cluster.address),
            env=cluster.env,
        )
    )

    assert code == 0, printed
    refused = [line for line in printed.splitlines() if "is refused" in line]
    assert len(refused) == (runtime == "native"), printed
    assert all("cpu generic" in line for line in refused)


@pytest.mark.nightly
def test_an_interrupted_run_goes_on_with_another_engine(cluster, nw_eval, until, tmp_path):
    cluster.start()
    here, there = tmp_path / "here", tmp_path / "there"
    api.run("smoke", out=here, workers=1)
    run = nw_eval(
        *("run", "smoke", "--out", there, "--engine", "ray", "--address", cluster.address),
        env=cluster.env,
    )
    try:
        until(lambda: journal_lines(there) >= 2, "a trial")
        os.killpg(run.pid, signal.SIGTERM)
        code, printed = ended(run)
    finally:
        run.kill()
    assert code == 130, printed
    assert "interrupted; continue with --resume" in printed
    assert journal_lines(there) < 5

    api.run(None, resume=there, workers=1)

    assert contents(there) == contents(here)


@pytest.mark.nightly
def test_a_run_whose_cluster_lost_its_head_can_be_resumed(cluster, nw_eval, until, tmp_path):
    cluster.start()
    run = nw_eval(
        *("run", "smoke", "--trials", "12", "--out", tmp_path / "run"),
        *("--engine", "ray", "--address", cluster.address),
        env=cluster.env,
    )
    try:
        until(lambda: journal_lines(tmp_path / "run") >= 2, "a trial")
        os.kill(cluster.control(), signal.SIGKILL)
        code, printed = ended(run)
    finally:
        run.kill()
    assert code == 4, printed  # And not 1, with which Ray would have ended it.
    assert "the head of the cluster has not answered" in printed
    assert "resume with --resume" in printed
