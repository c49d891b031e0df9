"""The action's own shell steps, run as a runner runs them, with the real `nw-eval`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: go1-parkour
trials: 3
seed: 7
episode: {duration: 0.2}
scenes:
  - flat/carpet_room
record: none
gate: {success_rate: 0.9}
"""


def test_inputs_are_options_and_outputs_are_the_verdicts_whatever_their_letters(
    composite: Any, tmp_path: Path
) -> None:
    suite = 'it\'s a "suite"; $(touch owned) `touch owned`.yaml'
    (tmp_path / "workspace" / suite).write_text(SUITE)
    (tmp_path / "event.json").write_text('{"pull_request": {"number": 7}}')
    action = composite(
        "nw-eval",
        {"suite": suite, "policy": "stand", "rounds": "1", "comment": "true"},
        GITHUB_EVENT_PATH=str(tmp_path / "event.json"),
    )
    outputs = action.run(leave_out="Install")
    assert outputs["verdict"] == "INCONCLUSIVE", action.log
    # A comment needs a token, which is missing here: a warning.
    assert action.codes == {"Run and judge": 3, "Comment on the pull request": 0}
    assert "::warning title=nw-eval comment::there is no GITHUB_TOKEN" in action.log
    assert outputs["exit-code"] == "3"
    assert (outputs["trials"], outputs["effect"]) == ("1", "0.000000")
    assert outputs["report-path"].startswith("reports/tiny-stand-")
    assert not list(tmp_path.rglob("owned"))
    assert (tmp_path / "summary").read_text().startswith("# INCONCLUSIVE: tiny, stand\n")
    python, cache, report, comment = action.used
    assert python == {"uses": "actions/setup-python", "python-version": "3.12"}
    assert cache["path"] == str(tmp_path / "temp" / "nw-eval" / "cache")
    assert (tmp_path / "workspace" / report["path"] / "report.md").is_file()
    assert Path(comment["path"]).read_text().startswith("<!-- nw-eval: tiny -->\n")
    assert [report["name"], comment["name"]] == ["nw-eval", "nw-eval-comment"]


def test_an_error_before_a_verdict_keeps_nothing_and_says_its_code(
    composite: Any, tmp_path: Path
) -> None:
    action = composite("nw-eval", {"suite": "nosuch", "cache": "false", "comment": "true"})
    outputs = action.run(leave_out="Install")
    assert action.codes == {"Run and judge": 2}
    assert (outputs["verdict"], outputs["exit-code"]) == ("", "2")
    assert "::error title=nw-eval::no suite 'nosuch'" in action.log
    assert [each["uses"] for each in action.used] == ["actions/setup-python"]
    assert not (tmp_path / "temp" / "nw-eval" / "comment.md").exists()


SHARED = {"suite": "tiny.yaml", "policy": "stand", "rounds": "2", "cache": "false"}


def run_part(composite: Any, workspace: Path, job: dict[str, Any]) -> None:
    """Run a job of a matrix, and put the folder that it keeps where a later job has it."""
    name = f"part-{job['index']}"
    inputs = {**SHARED, "shard": job["shard"], "artifact": name, "comment": "true"}
    action = composite("nw-eval", inputs)
    outputs = action.run(leave_out="Install")
    assert (outputs["verdict"], outputs["exit-code"], outputs["trials"]) == ("RAN", "0", "1")
    # A part is kept, and there is nothing of it to comment on.
    _, part = action.used
    assert part["name"] == name
    assert action.codes == {"Run and judge": 0}
    (workspace / "parts").mkdir(exist_ok=True)
    (workspace / part["path"]).rename(workspace / "parts" / name)


@pytest.mark.nightly
def test_jobs_that_share_a_suite_are_planned_and_one_that_is_missing_is_no_pass(
    composite: Any, tmp_path: Path
) -> None:
    (tmp_path / "workspace" / "tiny.yaml").write_text(SUITE)
    planned = composite("nw-eval", {**SHARED, "shards": "2"})
    first, second = json.loads(planned.run(leave_out="Install")["matrix"])["include"]
    assert (first["shard"], first["trials"]) == ("1/2", 1)
    assert (second["shard"], second["trials"]) == ("2/2", 1)
    assert [each["uses"] for each in planned.used] == ["actions/setup-python"]
    run_part(composite, tmp_path / "workspace", first)
    merging = composite("nw-eval", {**SHARED, "parts": "parts"})
    outputs = merging.run(leave_out="Install")
    assert (outputs["verdict"], outputs["exit-code"]) == ("", "4")
    assert merging.codes == {"Merge and judge": 4}
    assert "there is no part 2 of 2 (1 trial, first flat-carpet_room-0" in merging.log
    assert [each["uses"] for each in merging.used] == ["actions/setup-python"]


@pytest.mark.nightly
def test_jobs_that_share_a_suite_come_to_one_verdict(composite: Any, tmp_path: Path) -> None:
    (tmp_path / "workspace" / "tiny.yaml").write_text(SUITE)
    planned = composite("nw-eval", {**SHARED, "shards": "2"})
    for job in json.loads(planned.run(leave_out="Install")["matrix"])["include"]:
        run_part(composite, tmp_path / "workspace", job)
    merging = composite("nw-eval", {**SHARED, "parts": "parts"})
    outputs = merging.run(leave_out="Install")
    assert (outputs["verdict"], outputs["trials"]) == ("REGRESSED", "2"), merging.log
    assert outputs["report-path"] == "reports/merged"
    assert merging.codes == {"Merge and judge": 1}
    assert [each.get("name") for each in merging.used] == [None, "nw-eval", "nw-eval-comment"]


@pytest.mark.nightly
def test_the_action_runs_smoke(composite: Any, tmp_path: Path) -> None:
    action = composite("nw-eval", {"suite": "smoke", "policy": "go1-parkour", "render": "cpu"})
    outputs = action.run(leave_out="Install")
    assert (outputs["verdict"], outputs["exit-code"], outputs["trials"]) == ("RAN", "0", "4")
    assert float(outputs["effect"]) > 0.5
    assert len(list((tmp_path / "workspace" / outputs["report-path"]).rglob("*.mcap"))) == 4


@pytest.mark.nightly
def test_the_action_installs_its_own_commit(composite: Any, tmp_path: Path) -> None:
    # Into an environment of its own, which sees this one's libraries.
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "own"], check=True)
    inherited = next(p for p in map(Path, sys.path) if p.name == "site-packages")
    (site,) = (tmp_path / "own" / "lib").glob("python3*/site-packages")
    (site / "inherited.pth").write_text(f"{inherited}\n")
    own = tmp_path / "own" / "bin"
    action = composite(
        "nw-eval",
        {"suite": "smoke", "rounds": "1"},
        PIP_DISABLE_PIP_VERSION_CHECK="1",
        PYTHONPATH="",
    )
    action.environment["PATH"] = f"{own}:{action.environment['PATH']}"
    outputs = action.run()
    assert action.codes["Install nw-eval of the action's own commit"] == 0, action.log
    assert outputs["verdict"] == "RAN", action.log
    assert (own / "nw-eval").is_file()
