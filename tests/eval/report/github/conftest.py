"""GitHub's runner, as far as it reads what a step writes: after its source, in few lines.

actions/runner, src/Runner.Common/ActionCommand.cs (`TryParseV2`) and
src/Runner.Worker/FileCommandManager.cs (`EnvFileKeyValuePairs`).
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command as the runner has understood it."""

    name: str
    message: str
    properties: dict[str, str]


def unescaped(text, *pairs):
    for pair in ("\r%0D", "\n%0A", *pairs, "%%25"):
        text = text.replace(pair[1:], pair[0])
    return text


class Runner:
    """What reads a log and the files of a step."""

    @staticmethod
    def commands(log):
        found = []
        for line in log.splitlines():
            if not line.lstrip().startswith("::") or "::" not in line.lstrip()[2:]:
                continue
            head, _, message = line.lstrip()[2:].partition("::")
            name, _, settings = head.partition(" ")
            pairs = [pair.split("=", 1) for pair in settings.split(",") if "=" in pair]
            properties = {key.strip(): unescaped(value, ":%3A", ",%2C") for key, value in pairs}
            found.append(Command(name=name, message=unescaped(message), properties=properties))
        return found

    @staticmethod
    def outputs(text):
        found = {}
        lines = iter(text.splitlines(keepends=True))
        for line in lines:
            equals, heredoc = line.find("="), line.find("<<")
            if heredoc < 0 or 0 <= equals < heredoc:
                name, _, value = line.rstrip("\n").partition("=")
                assert name, f"Invalid format {line!r}"
                found[name] = value
                continue
            name, _, fence = line.rstrip("\n").partition("<<")
            assert name
            assert fence
            value = []
            for inner in lines:
                if inner.rstrip("\n") == fence:
                    break
                value.append(inner)
            else:
                raise AssertionError(f"Invalid value. Matching delimiter not found {fence!r}")
            found[name] = "".join(value).removesuffix("\n")
        return found


@pytest.fixture
def runner():
    return Runner
