"""`--track` says at once what is missing, and never costs a verdict or its exit code."""

import os
import shutil
import subprocess
import sys

import pytest
from command_line import ends

from nw_eval.reporting.trackers import tracked as trackers


@pytest.fixture
def run(regressed_run, tmp_path):
    """A finished run of one's own, whose verdict is REGRESSED."""
    return shutil.copytree(regressed_run, tmp_path / "run")


def test_a_tracker_that_is_not_installed_is_named_with_its_extra_before_anything_runs(
    monkeypatch, capsys, tmp_path
):
    monkeypatch.setattr(trackers, "find_spec", lambda _: None)
    out = tmp_path / "out"
    assert ends("run", "smoke", "--out", out, "--track", "wandb") == 2
    told = capsys.readouterr().err
    assert told == (
        "error: --track wandb needs wandb, which is not installed; pip install 'nw-eval[wandb]'\n"
    )
    assert not out.exists()


@pytest.mark.parametrize("typed", [["--track", "wandbb"], ["--track", "mlflow,wandbb"]])
def test_a_tracker_that_there_is_not_is_a_usage_error(typed, monkeypatch, capsys, run):
    monkeypatch.setattr(trackers, "find_spec", lambda _: object())
    assert ends("gate", run, *typed) == 2
    assert "no such tracker; did you mean 'wandb'?" in capsys.readouterr().err


def test_a_tracker_that_fails_is_a_warning_and_leaves_the_verdict(run, capsys):
    pytest.importorskip("tensorboard")
    (run / "events.out.tfevents.nw-eval").mkdir()  # Where its file would be.
    assert ends("gate", run, "--track", "tensorboard") == 1
    shown = capsys.readouterr()
    assert "REGRESSED" in shown.out
    assert shown.err.startswith("warning: no tensorboard run: cannot write ")
    assert len(shown.err.splitlines()) == 1


def test_trackers_can_be_repeated_and_joined_and_load_no_simulation(run):
    for name in trackers.TRACKERS:
        pytest.importorskip(name)
    code = (
        "import sys\n"
        "from nw_eval import cli\n"
        "try: cli.main(sys.argv[1:])\n"
        "except SystemExit as left: print('exit', left.code)\n"
        "print(sorted({'torch', 'mujoco', 'numba', 'tensorflow'} & set(sys.modules)))"
    )
    typed = ["report", str(run), "--track", "tensorboard,mlflow", "--track", "wandb"]
    # Nowhere to go: no store of that kind, and no user is logged in.
    nowhere = {"MLFLOW_TRACKING_URI": "nowhere://", "WANDB_MODE": "online", "WANDB_API_KEY": ""}
    home = {"HOME": str(run), "NETRC": str(run / "netrc"), "WANDB_BASE_URL": "http://127.0.0.1:9"}
    quiet = {"MLFLOW_DISABLE_TELEMETRY": "true", "WANDB_ERROR_REPORTING": "false"}
    shown = subprocess.run(
        [sys.executable, "-c", code, *typed],
        capture_output=True,
        text=True,
        check=True,
        cwd=run,
        env={**os.environ, **nowhere, **home, **quiet},
    )
    assert shown.stdout.splitlines()[-2:] == ["exit 1", "[]"]
    assert [line.split(":")[1] for line in shown.stderr.splitlines() if "warning: no" in line] == [
        " no mlflow run",
        " no wandb run",
    ]
    assert (run / "events.out.tfevents.nw-eval").is_file()
