"""The JSON Schema of suite files, for editors that complete and check YAML as one types."""

from __future__ import annotations

from typing import Any

from nw_eval.suite.model import Suite


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a suite file.

    In VS Code and others with yaml-language-server, the first line of a suite then says
    `# yaml-language-server: $schema=suite.schema.json`.
    """
    schema = Suite.model_json_schema(by_alias=True)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "nw-eval suite",
    }
