"""The action's own shell steps, run as a runner runs them, with the real `nw-eval`."""

from __future__ import annotations

import json
import os
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
TAKE = "Take baselines from the base branch"


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
    assert action.codes == {TAKE: 0, "Run and judge": 3, "Comment on the pull request": 0}
    assert "::warning title=nw-eval comment::there is no GITHUB_TOKEN" in action.log
    assert outputs["exit-code"] == "3"
    assert (outputs["trials"], outputs["success"]) == ("1", "0.000000")
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
    assert action.codes == {TAKE: 0, "Run and judge": 2}
    assert (outputs["verdict"], outputs["exit-code"]) == ("", "2")
    assert "::error title=nw-eval::no suite 'nosuch'" in action.log
    assert [each["uses"] for each in action.used] == ["actions/setup-python"]
    assert not (tmp_path / "temp" / "nw-eval" / "comment.md").exists()


def git(folder: Path, *words: str) -> str:
    """Run git as a person without a home."""
    who = ("-c", "user.name=Someone", "-c", "user.email=someone@example.org")
    done = subprocess.run(
        ["git", *who, *words], cwd=folder, check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


@pytest.fixture
def pull_request(tmp_path: Path) -> tuple[Path, str]:
    """A clone of one commit, as a checkout makes it, of a branch that brings baselines; its base.

    The branch changes one, adds one, removes one, and changes a table that nobody committed.
    """
    upstream, workspace = tmp_path / "upstream", tmp_path / "workspace"
    own = upstream / "reports" / "baselines" / "tiny"
    own.mkdir(parents=True)
    (upstream / "tiny.yaml").write_text(SUITE)
    (own / "changed.parquet").write_bytes(b"of the base")
    (own / "removed.parquet").write_bytes(b"of the base")
    git(upstream, "init", "--quiet", "--initial-branch=main")
    git(upstream, "config", "uploadpack.allowReachableSHA1InWant", "true")
    git(upstream, "add", ".")
    git(upstream, "commit", "--quiet", "-m", "base")
    base = git(upstream, "rev-parse", "HEAD")
    git(upstream, "checkout", "--quiet", "-b", "theirs")
    (own / "changed.parquet").write_bytes(b"forged")
    (own / "removed.parquet").unlink()
    (own / "*.parquet").write_bytes(b"forged")
    (upstream / "beside.parquet").write_bytes(b"forged")
    (upstream / "linked.parquet").symlink_to("tiny.yaml")
    (upstream / "tiny.yaml").write_text(SUITE + "# theirs\n")
    git(upstream, "add", "--all")
    git(upstream, "commit", "--quiet", "-m", "theirs")
    git(
        tmp_path,
        "clone",
        "--quiet",
        "--depth=1",
        "--branch=theirs",
        f"file://{upstream}",
        "workspace",
    )
    (workspace / "parts").mkdir()
    (workspace / "parts" / "trials.parquet").write_bytes(b"of a part")
    return workspace, base


def baselines(workspace: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(workspace.rglob("*.parquet"))}


def test_a_pull_request_is_judged_by_the_baselines_of_its_base_branch(
    composite: Any, pull_request: tuple[Path, str]
) -> None:
    workspace, base = pull_request
    action = composite("nw-eval", {"suite": "nosuch", "cache": "false"})
    action.event = {"pull_request": {"base": {"sha": base}}}
    action.run(leave_out="Install")
    assert action.codes[TAKE] == 0, action.log
    assert baselines(workspace) == {
        "changed.parquet": b"of the base",
        "removed.parquet": b"of the base",
        "trials.parquet": b"of a part",
    }
    assert "as in the base branch: reports/baselines/tiny/changed.parquet" in action.log
    assert "not in the base branch, removed: beside.parquet" in action.log
    assert (workspace / "tiny.yaml").read_text().endswith("# theirs\n"), "the rest is theirs"


def test_a_push_keeps_its_baselines_and_so_does_a_pull_request_that_asks_for_them(
    composite: Any, pull_request: tuple[Path, str]
) -> None:
    workspace, base = pull_request
    before = baselines(workspace)
    for inputs, event in (
        ({}, {}),
        ({"baseline-from": "checkout"}, {"pull_request": {"base": {"sha": base}}}),
    ):
        action = composite("nw-eval", {"suite": "nosuch", "cache": "false", **inputs})
        action.event = event
        action.run(leave_out="Install")
        assert action.codes["Run and judge"] == 2, "the suite is none, and that is all"
        assert baselines(workspace) == before


@pytest.mark.parametrize("fault", ["no base", "no repository", "no such word"])
def test_without_the_base_branch_nothing_is_judged(
    composite: Any, pull_request: tuple[Path, str], fault: str
) -> None:
    workspace, base = pull_request
    inputs = {"suite": "tiny.yaml", "policy": "stand", "cache": "false"}
    if fault == "no such word":
        inputs["baseline-from"] = "here"
    if fault == "no repository":
        (workspace / ".git").rename(workspace / "git")
    action = composite("nw-eval", inputs, GIT_CEILING_DIRECTORIES=str(workspace.parent))
    sha = "0" * 40 if fault == "no base" else base
    action.event = {"pull_request": {"base": {"sha": sha}}}
    outputs = action.run(leave_out="Install")
    assert action.codes[TAKE] != 0
    assert "Run and judge" not in action.codes
    assert outputs["verdict"] == ""


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
    assert action.codes == {TAKE: 0, "Run and judge": 0}
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
    assert merging.codes == {TAKE: 0, "Merge and judge": 4}
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
    assert merging.codes == {TAKE: 0, "Merge and judge": 1}
    assert [each.get("name") for each in merging.used] == [None, "nw-eval", "nw-eval-comment"]


@pytest.mark.nightly
def test_the_action_runs_smoke(composite: Any, tmp_path: Path) -> None:
    action = composite("nw-eval", {"suite": "smoke", "policy": "go1-parkour", "render": "cpu"})
    outputs = action.run(leave_out="Install")
    assert (outputs["verdict"], outputs["exit-code"], outputs["trials"]) == ("RAN", "0", "4")
    assert float(outputs["success"]) > 0.5
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


@pytest.mark.parametrize(
    ("event", "cache", "is_taken"),
    [
        ("pull_request", "true", False),
        ("pull_request_target", "true", False),
        ("pull_request", "all", True),
        ("push", "true", True),
    ],
)
def test_no_result_that_a_pull_request_can_write_feeds_its_gate(
    composite: Any, tmp_path: Path, event: str, cache: str, is_taken: bool
) -> None:
    (tmp_path / "workspace" / "nw-eval").write_text('#!/bin/sh\necho "$@" > told\n')
    (tmp_path / "workspace" / "nw-eval").chmod(0o755)
    action = composite("nw-eval", {"suite": "it", "cache": cache}, GITHUB_EVENT_NAME=event)
    action.environment["PATH"] = f"{tmp_path / 'workspace'}:{os.environ['PATH']}"
    action.run(leave_out="Install")
    told = (tmp_path / "workspace" / "told").read_text().split()
    assert ("--no-cache" not in told) is is_taken
    assert any(step["uses"] == "actions/cache" for step in action.used)


FAKE = """#!/bin/sh
echo "$@" >> calls
n=$(wc -l < calls)
code=$(sed -n "${n}p" codes)
[ -s folder ] && printf 'report-path<<x\\n%s\\nx\\n' "$(cat folder)" >> "$GITHUB_OUTPUT"
exit "$code"
"""


@pytest.mark.parametrize(
    ("codes", "folder", "retry", "ends", "calls"),
    [
        ("4 0", "reports/it-1", "true", 0, ["it", "--resume reports/it-1"]),
        ("4 4 0", "reports/it-1", "true", 4, ["it", "--resume reports/it-1"]),
        ("4 1", "", "true", 1, ["it", "it"]),
        ("4 0", "reports/it-1", "false", 4, ["it"]),
        ("1 0", "reports/it-1", "true", 1, ["it"]),
        ("0", "reports/it-1", "true", 0, ["it"]),
    ],
)
def test_a_run_with_an_infrastructure_error_is_resumed_once(
    composite: Any, tmp_path: Path, codes: str, folder: str, retry: str, ends: int, calls: list[str]
) -> None:
    workspace = tmp_path / "workspace"
    (workspace / "nw-eval").write_text(FAKE)
    (workspace / "nw-eval").chmod(0o755)
    (workspace / "codes").write_text("\n".join([*codes.split(), ""]))
    (workspace / "folder").write_text(folder)
    action = composite("nw-eval", {"suite": "it", "retry": retry}, GITHUB_EVENT_NAME="pull_request")
    action.environment["PATH"] = f"{workspace}:{os.environ['PATH']}"
    action.run(leave_out="Install")
    assert action.codes["Run and judge"] == ends, action.log
    told = (workspace / "calls").read_text().splitlines()
    assert [line.partition("run ")[2].partition(" --github")[0] for line in told] == calls
    assert all("--no-cache" in line for line in told), "no result of the pull request counts"
