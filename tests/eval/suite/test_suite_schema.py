from __future__ import annotations

import json
from typing import Any

from nw_eval.suite import json_schema
from nw_scenes.robots import BUILT_IN


def settings() -> dict[str, Any]:
    return json_schema()["properties"]


def test_the_schema_names_every_setting_of_the_format() -> None:
    assert set(settings()) == {
        "nw-eval",
        "name",
        "robot",
        "policy",
        "protocol",
        "trials",
        "seed",
        "episode",
        "task",
        "scenes",
        "perturb",
        "render",
        "scores",
        "expect",
        "record",
        "gate",
        "plugins",
    }


def test_an_editor_can_refuse_unknown_keys_and_offer_values() -> None:
    schema = json_schema()
    assert schema["additionalProperties"] is False
    assert all(part["additionalProperties"] is False for part in schema["$defs"].values())
    assert settings()["record"]["enum"] == ["all", "failures", "none", "summary"]
    assert settings()["trials"]["minimum"] == 1
    assert set(schema["required"]) == {
        "nw-eval",
        "name",
        "robot",
        "policy",
        "trials",
        "seed",
        "scenes",
    }


def test_the_schema_offers_the_robots_that_are_built_in_and_takes_any_other() -> None:
    offered = settings()["robot"]
    assert offered["examples"] == list(BUILT_IN)
    assert "enum" not in offered
    assert offered["type"] == "string"


def test_an_editor_can_explain_every_setting() -> None:
    schema = json_schema()
    parts = [schema, *schema["$defs"].values()]
    for part in parts:
        for name, setting in part["properties"].items():
            assert "description" in setting or "$ref" in setting, name


def test_the_schema_is_plain_json() -> None:
    assert json.loads(json.dumps(json_schema())) == json_schema()
