"""A composite action as GitHub's runner runs it: its expressions, and its steps in bash."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
ACTIONS = ROOT / ".github" / "actions"

_EXPRESSION = re.compile(r"\$\{\{\s*(.+?)\s*\}\}")


def load(text: str) -> Any:
    return YAML(typ="safe", pure=True).load(text)


def split(expression: str, sign: str) -> list[str]:
    """Split an expression at a sign, but not within parentheses."""
    parts, depth = [""], 0
    for piece in re.split(rf"({re.escape(sign)}|[()])", expression):
        depth += {"(": 1, ")": -1}.get(piece, 0)
        if piece == sign and depth == 0:
            parts.append("")
        else:
            parts[-1] += piece
    return [part.strip() for part in parts]


def outputs_of(text: str) -> dict[str, str]:
    """Read outputs as a runner does: `name=value` lines, and values between delimiters."""
    found: dict[str, str] = {}
    lines = iter(text.splitlines())
    for line in lines:
        if "<<" in line.split("=")[0]:
            name, delimiter = line.split("<<", 1)
            found[name] = "\n".join(iter(lines.__next__, delimiter))
        else:
            name, _, value = line.partition("=")
            found[name] = value
    return found


@dataclass
class Composite:
    """The shell steps of an action; `uses` steps are remembered with their inputs, not run."""

    folder: Path
    inputs: dict[str, str]
    work: Path
    environment: dict[str, str]
    event: dict[str, Any] = field(default_factory=dict)
    outputs: dict[str, dict[str, str]] = field(default_factory=dict)
    used: list[dict[str, Any]] = field(default_factory=list)
    codes: dict[str, int] = field(default_factory=dict)
    log: str = ""

    def run(self, *, leave_out: str = "") -> dict[str, str]:
        """Run what would run, but steps whose name has some words; return the action's outputs."""
        action = load((self.folder / "action.yml").read_text())
        unknown = self.inputs.keys() - action["inputs"].keys()
        assert not unknown, f"the action has no inputs {unknown}"
        given = {name: each.get("default", "") for name, each in action["inputs"].items()}
        self.inputs = {name: self.filled(value) for name, value in given.items()} | self.inputs
        failed = False
        for step in action["runs"]["steps"]:
            condition = step.get("if", "success()")
            if failed and "always()" not in condition:
                continue
            if not self.value(condition):
                continue
            if "uses" in step:
                settings = {key: self.filled(str(value)) for key, value in step["with"].items()}
                self.used.append({"uses": step["uses"].split("@")[0], **settings})
            elif not (leave_out and leave_out in step.get("name", "")):
                failed |= self._shell(step) != 0
        shown = action.get("outputs", {})
        return {name: self.filled(each["value"]) for name, each in shown.items()}

    def _shell(self, step: dict[str, Any]) -> int:
        assert step["shell"] == "bash"
        assert "${{" not in step["run"], "an input that is pasted into a script is code"
        output = self.work / "output"
        output.write_text("")
        script = self.work / "script.sh"
        script.write_text(step["run"])
        own = {name: self.filled(str(value)) for name, value in step.get("env", {}).items()}
        done = subprocess.run(
            ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", script],
            env={**self.environment, **own, "GITHUB_OUTPUT": str(output)},
            cwd=self.work / "workspace",
            capture_output=True,
            text=True,
            check=False,
        )
        self.log += done.stdout + done.stderr
        self.outputs[step.get("id", "")] = outputs_of(output.read_text())
        self.codes[step.get("name", "")] = done.returncode
        return done.returncode

    def filled(self, text: str) -> str:
        """Return a text with its expressions evaluated."""
        return _EXPRESSION.sub(lambda found: str(self.value(found[1])), text)

    def value(self, expression: str) -> Any:
        """Return the value of an expression; there are few kinds of them."""
        for sign, decides in (("||", bool), ("&&", lambda value: not value)):
            parts = split(expression, sign)
            if len(parts) > 1:  # The value is that of the part that decides, or of the last.
                values = (self.value(part) for part in parts)
                return next((value for value in values if decides(value)), self.value(parts[-1]))
        if expression.startswith("(") and expression.endswith(")"):
            return self.value(expression[1:-1].strip())
        if compared := re.fullmatch(r"(\S+) (==|!=) '([^']*)'", expression):
            same = self.value(compared[1]) == compared[3]
            return same if compared[2] == "==" else not same
        if expression in {"always()", "success()"}:
            return True
        if expression.startswith("hashFiles("):
            return "0" * 64
        known = {
            "github.action_path": str(self.folder),
            "github.token": self.environment.get("TOKEN", ""),
            "runner.temp": str(self.work / "temp"),
            "runner.os": "Linux",
            "runner.arch": "X64",
        }
        room, _, name = expression.partition(".")
        if room == "inputs":
            return self.inputs[name]
        if found := re.fullmatch(r"steps\.(\w+)\.outputs\.([\w-]+)", expression):
            return self.outputs.get(found[1], {}).get(found[2], "")
        return known[expression] if expression in known else self._of_event(expression)

    def _of_event(self, expression: str) -> Any:
        """Return what the event says, and nothing where it does not."""
        github, event, *keys = expression.split(".")
        assert (github, event) == ("github", "event")
        value: Any = self.event
        for key in keys:
            value = value.get(key, "") if isinstance(value, dict) else ""
        return value


@pytest.fixture
def composite(tmp_path: Path) -> Any:
    """Make an action ready to run in a workspace of its own."""
    for name in ("workspace", "temp"):
        (tmp_path / name).mkdir()

    def make(action: str, inputs: dict[str, str], **environment: str) -> Composite:
        return Composite(
            folder=ACTIONS / action,
            inputs=inputs,
            work=tmp_path,
            environment={
                **os.environ,
                "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
                "GITHUB_ACTIONS": "true",
                "GITHUB_STEP_SUMMARY": str(tmp_path / "summary"),
                "GITHUB_WORKSPACE": str(tmp_path / "workspace"),
                **environment,
            },
        )

    return make
