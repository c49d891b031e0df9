"""Going on with a run: from anywhere, on the same kind of processor, after any kind of end."""

import os
import shutil
import subprocess
import sys

import pytest

from nw_base.errors import IncomparableError, StoreError, UsageError
from nw_base.files.shipped import shipped
from nw_eval import api
from nw_eval.cli.verbs.options import summary
from nw_gate.results.journal import Journal, read_journal
from nw_gate.results.provenance import read_run_info
from nw_gate.results.row import rows_digest

SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: ./mine
trials: 3
seed: 5
episode: {duration: 0.4}
scenes: [hurdles/three_low]
record: none
gate: {success_rate: 0.3}
"""


@pytest.fixture
def project(tmp_path, monkeypatch):
    """Return a folder with a suite and the policy that it names by its place beside it."""
    folder = tmp_path / "project"
    shutil.copytree(shipped("policies") / "stand", folder / "mine")
    (folder / "quick.yaml").write_text(SUITE)
    monkeypatch.chdir(folder)
    return folder


def cut(folder, rows):
    """Leave of a run what a kill after some rows leaves."""
    journal = folder / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[: 1 + rows]))
    kept = {row.trial_id for row in read_journal(journal).rows}
    for log in folder.glob("mcap/**/*.mcap"):
        if log.stem not in kept:
            log.unlink()
    (folder / "trials.parquet").unlink()


def test_a_run_is_resumed_from_elsewhere_to_the_same_rows_and_the_same_logs(
    project, tmp_path, monkeypatch
):
    whole = api.run("quick.yaml", out=project / "whole")
    shutil.copytree(project / "whole", project / "cut")
    cut(project / "cut", rows=1)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    resumed = api.run(None, resume=project / "cut")
    assert rows_digest(resumed.rows) == rows_digest(whole.rows)
    logs = sorted(path.relative_to(project / "whole") for path in project.glob("whole/**/*.mcap"))
    assert len(logs) == 3
    for log in logs:
        assert (project / "cut" / log).read_bytes() == (project / "whole" / log).read_bytes()
    before, after = (read_run_info(project / name / "run.json") for name in ("whole", "cut"))
    assert after.suite == before.suite
    assert after.suite_file == before.suite_file == "quick.yaml"

    # Fewer trials than have run: what is not planned is kept, and not judged.
    fewer = api.run(None, resume=project / "cut", trials=2)
    assert fewer.verdict.n == fewer.verdict.planned == len(fewer.rows) == 2
    assert "3 of 2" not in summary(fewer)
    assert "not judged" in summary(fewer)
    assert len(read_journal(project / "cut" / "journal.jsonl").rows) == 3


def stop_before_the_journal(monkeypatch):
    """Let the run end where its journal is to be started."""

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Journal, "create", stop)


@pytest.mark.parametrize("left", [None, b'{"journal":3,"suite_dig'])
def test_a_folder_in_which_nothing_has_run_can_be_started_again_and_resumed(
    project, monkeypatch, left
):
    out = project / "run"
    with monkeypatch.context() as patch:
        stop_before_the_journal(patch)
        with pytest.raises(KeyboardInterrupt):
            api.run("quick.yaml", out=out, trials=1)
    assert [path.name for path in out.iterdir()] == ["run.json"]
    if left is not None:  # The first line was torn.
        (out / "journal.jsonl").write_bytes(left)
    with monkeypatch.context() as patch:
        stop_before_the_journal(patch)
        with pytest.raises(KeyboardInterrupt):
            api.run(None, resume=out)
        with pytest.raises(KeyboardInterrupt):
            api.run("quick.yaml", out=out, trials=1)
    assert len(api.run(None, resume=out).rows) == 1
    with pytest.raises(UsageError, match="already holds a run; continue with --resume"):
        api.run("quick.yaml", out=out, trials=1)


KILLED = """
import os, signal
from pathlib import Path
from nw_eval import api
from nw_eval.cli.verbs.options import summary
from nw_gate.results.journal import Journal

Journal._begin = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
api.run("quick.yaml", out=Path("run"), trials=1)
"""


def test_a_kill_between_run_json_and_the_first_line_costs_nothing(project):
    done = subprocess.run([sys.executable, "-c", KILLED], cwd=project, check=False)
    assert done.returncode == -9
    assert (project / "run" / "journal.jsonl").read_bytes() == b""
    assert len(api.run(None, resume=project / "run").rows) == 1


def full(_):
    raise OSError(28, "No space left on device")


def test_a_full_disk_at_the_very_start_leaves_a_folder_that_can_be_started(project, monkeypatch):
    out = project / "run"
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(StoreError, match=r"cannot write .*run\.json: No space left"):
            api.run("quick.yaml", out=out, trials=1)
    assert list(out.iterdir()) == []
    stop_before_the_journal(monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        api.run("quick.yaml", out=out, trials=1)


def test_a_run_by_another_runtime_is_not_resumed_on_another_kind_of_processor(project, monkeypatch):
    shutil.rmtree(project / "mine")
    shutil.copytree(shipped("policies") / "go1-parkour", project / "mine")
    card = project / "mine" / "policy.yaml"
    card.write_text(card.read_text().replace("adapter: onnx\n", "adapter: onnx\nruntime: native\n"))
    api.run("quick.yaml", out=project / "run", trials=1)
    before = (project / "run" / "journal.jsonl").read_bytes()
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    with pytest.raises(IncomparableError, match=r"cpu \(\w.*, now generic ") as caught:
        api.run(None, resume=project / "run", trials=2)
    assert caught.value.exit_code == 5
    assert (project / "run" / "journal.jsonl").read_bytes() == before


@pytest.mark.parametrize(
    ("gate", "said"),
    [
        ("{success_rate: 0.1}", "gate.success_rate is 0.1, it was started with 0.3"),
        (
            "{success_rate: 0.3, confidence: 0.5}",
            "gate.confidence is 0.5, it was started with 0.95",
        ),
        ("{}", "gate.success_rate is None, it was started with 0.3"),
        (
            "{success_rate: 0.3, tiers: {'*': informational}}",
            "gate.tiers is {'*': 'informational'}",
        ),
    ],
)
def test_a_run_is_not_resumed_to_be_judged_by_other_rules_than_it_was_started_with(
    project, gate, said
):
    api.run("quick.yaml", out=project / "run", trials=1)
    own = SUITE[SUITE.index("gate:") :]
    (project / "quick.yaml").write_text(SUITE.replace(own, f"gate: {gate}\n"))
    with pytest.raises(IncomparableError) as caught:
        api.run("quick.yaml", resume=project / "run")
    assert "with another gate" in caught.value.message
    assert said in caught.value.message
    assert caught.value.exit_code == 5
    # More rounds are no other rules, and without a suite the run is judged as it was begun.
    (project / "quick.yaml").write_text(SUITE.replace("0.3}", "0.3, rounds: 30}"))
    assert api.run("quick.yaml", resume=project / "run", trials=2).verdict.bar == 0.3
    assert api.run(None, resume=project / "run").verdict.bar == 0.3
