"""What a release says of itself is one thing in all places."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

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
        "publish": {"id-token": "write"},
    }
    steps = [step["uses"] for job in jobs.values() for step in job["steps"] if "uses" in step]
    assert steps
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", step) for step in steps)
    # Nothing of the project runs where an upload is allowed.
    assert not [step for step in jobs["publish"]["steps"] if "run" in step]


def test_the_image_has_the_versions_of_the_constraints():
    build = re.search(r"build==([\d.]+)", (ROOT / "Dockerfile").read_text())
    assert build is not None
    assert f"\nbuild=={build[1]}\n" in (ROOT / "constraints.txt").read_text()
