"""`nw-eval schema policy`: every key of a card, with its meaning."""

import json

import pytest

from nw_eval import api
from nw_policies.cards import Card


@pytest.fixture(scope="module")
def models():
    """Every model of the schema by name, the card itself among them."""
    schema = api.schema("policy")
    return schema["$defs"] | {"Card": schema}


def test_every_key_says_what_it_means(models):
    keys = {
        (model, key): stated
        for model, schema in models.items()
        for key, stated in schema.get("properties", {}).items()
    }
    assert len(keys) > 200
    assert [key for key, stated in keys.items() if not stated.get("description", "").strip()] == []


def test_the_meaning_is_what_stands_under_the_field_or_over_its_class(models):
    control = models["Control"]["properties"]
    assert (
        control["kp"]["description"]
        == "Position gain, N m/rad; None = the robot's, here and below."
    )
    # Inherited, and a key whose one value names the model.
    assert models["LidarObservation"]["properties"]["latency"]["description"] == (
        "Age of a sample when the policy first sees it, s."
    )
    term = models["Gravity"]["properties"]["term"]
    assert term["const"] == "gravity"
    assert term["description"].startswith("Direction of gravity, a unit vector (3)")


def test_descriptions_change_nothing_else(models):
    def without(schema):
        if isinstance(schema, dict):
            return {
                key: without(value)
                for key, value in schema.items()
                if key != "description" or not isinstance(value, str)
            }
        return [without(value) for value in schema] if isinstance(schema, list) else schema

    plain = Card.model_json_schema(by_alias=True)
    assert without(models["Card"]) == without(json.loads(json.dumps(plain)))
