"""What a release says of itself is one thing in all places."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pytest
from ruamel.yaml import YAML

import nw_eval

ROOT = Path(__file__).parents[2]


def yaml(path):
    return YAML(typ="safe").load(ROOT / path)


def test_the_citation_is_of_this_version_and_names_the_paper():
    citation = yaml("CITATION.cff")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert citation["version"] == nw_eval.__version__
    assert (citation["title"], citation["license"]) == (project["name"], project["license"])
    assert citation["references"][0]["url"] == project["urls"]["Paper"]


def test_a_tag_is_published_without_a_token_and_by_pinned_steps_alone():
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text()
    assert "secrets." not in text
    jobs = yaml(".github/workflows/release.yml")["jobs"]
    assert {name: job["permissions"] for name, job in jobs.items()} == {
        "build": {"contents": "read"},
        "image": {"contents": "read"},
        "publish": {"id-token": "write", "attestations": "write"},
        "publish-page": {"contents": "write"},
        "publish-image": {"packages": "write", "id-token": "write", "attestations": "write"},
    }
    steps = [step["uses"] for job in jobs.values() for step in job["steps"] if "uses" in step]
    assert steps
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", step) for step in steps)
    # Nothing of the project runs where an upload is allowed: Docker moves an image that was built.
    assert not [step for step in jobs["publish"]["steps"] if "run" in step]
    (moved,) = [step["run"] for step in jobs["publish-image"]["steps"] if "run" in step]
    assert not re.search(r"docker (run|build)|python|make|nw-eval [a-z]", moved)
    (page,) = [step["run"] for step in jobs["publish-page"]["steps"] if "run" in step]
    assert page.startswith('gh release create "$GITHUB_REF_NAME" dist/* --verify-tag ')
    for name in ("publish", "publish-page", "publish-image"):
        steps = [step.get("uses", "") for step in jobs[name]["steps"]]
        assert not [step for step in steps if step.startswith("actions/checkout@")]
    for name in ("publish", "publish-image"):
        steps = [step.get("uses", "") for step in jobs[name]["steps"]]
        assert [step for step in steps if step.startswith("actions/attest-build-provenance@")]


def test_the_changelog_begins_with_this_version_and_a_tag_needs_its_date():
    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    version = re.escape(nw_eval.__version__)
    assert re.fullmatch(rf"{version} \((unreleased|\d{{4}}-\d{{2}}-\d{{2}})\)", headings[0])
    steps = yaml(".github/workflows/release.yml")["jobs"]["build"]["steps"]
    (asked,) = [step["run"] for step in steps if "CHANGELOG.md" in step.get("run", "")]
    form = re.search(r'"(## .+)"', asked)
    assert form is not None
    form = form[1].replace("${GITHUB_REF_NAME#v}", version)
    assert re.fullmatch(form, f"## {nw_eval.__version__} (2026-12-01)")
    assert not re.fullmatch(form, f"## {nw_eval.__version__} (unreleased)")


def test_the_image_has_the_versions_of_the_constraints():
    build = re.search(r"build==([\d.]+)", (ROOT / "Dockerfile").read_text())
    assert build is not None
    assert f"\nbuild=={build[1]}\n" in (ROOT / "constraints.txt").read_text()


def test_an_update_never_moves_what_results_depend_on():
    (updates,) = (
        update["ignore"]
        for update in yaml(".github/dependabot.yml")["updates"]
        if update["package-ecosystem"] == "pip"
    )
    lists = (ROOT / "constraints.txt").read_text().split("# ")
    pinned = [
        part for part in lists if part.startswith(("What changes results", "What changes pl"))
    ]
    assert len(pinned) == 2
    names = {line.split("==")[0] for part in pinned for line in part.splitlines()[1:] if line}
    assert {entry["dependency-name"] for entry in updates} == names


@pytest.mark.parametrize("name", ["bug", "checkpoint", "feature"])
def test_an_issue_s_form_asks_for_what_reproduces_it(name):
    form = yaml(f".github/ISSUE_TEMPLATE/{name}.yml")
    assert form["name"]
    assert form["description"]
    asked = [field["id"] for field in form["body"]]
    assert len(set(asked)) == len(asked)
    assert all(field["type"] in {"input", "textarea"} for field in form["body"])
    assert all(field["attributes"]["label"] for field in form["body"])
    required = [x for x in form["body"] if x.get("validations", {}).get("required")]
    assert required


def test_hooks_before_a_commit_are_steps_of_the_checks():
    makefile = (ROOT / "Makefile").read_text()
    (local,) = yaml(".pre-commit-config.yaml")["repos"]
    for hook in local["hooks"]:
        program, *options = hook["entry"].split()
        step = " ".join(["$(BIN)/" + Path(program).name, *options])
        assert step.replace(".venv/bin/", "$(BIN)/") in makefile, hook["id"]


def test_a_dev_container_is_set_up_by_targets_that_there_are():
    container = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text())
    target = container["postCreateCommand"].split()[1]
    assert target.replace(".venv", "$(VENV)") + ":" in (ROOT / "Makefile").read_text()
    python = container["image"].split(":")[1].split("-")[0]
    tests = yaml(".github/workflows/ci.yml")["jobs"]["test"]
    assert python in tests["strategy"]["matrix"]["python"]
