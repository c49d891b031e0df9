"""One table of sensors, one of wrappers: names, schema, measurements and pages follow from them."""

from pathlib import Path
from typing import get_args

import pytest
from pydantic import TypeAdapter

from nw_policies.cards.load import json_schema
from nw_policies.cards.observations import BUILT_IN_SENSORS, BuiltInObservation
from nw_policies.cards.wrappers import BUILT_IN_WRAPPERS, BuiltInWrapper, Wrapper
from nw_sim.sensors import check_card
from nw_sim.sensors.wrappers import Chain, Spec, make_wrappers

NEEDED = {
    "proprio": {"layout": "parkour53"},
    "reference": {"terms": ["joint_positions"]},
}
NEEDED_BY_WRAPPERS = {
    "resize": {"width": 4, "height": 2},
    "clip": {"limits": 1.0},
    "stack": {"steps": 2},
}
PAGE = Path(__file__).parents[3] / "docs" / "reference" / "sensors.md"


def names_in_schema(key):
    """The names that the card's schema has for models with this key."""
    parts = [part["properties"] for part in json_schema()["$defs"].values() if "properties" in part]
    return {part[key]["const"] for part in parts if "const" in part.get(key, {})}


@pytest.mark.parametrize(
    ("key", "names", "union"),
    [
        ("sensor", BUILT_IN_SENSORS, BuiltInObservation),
        ("wrapper", BUILT_IN_WRAPPERS, BuiltInWrapper),
    ],
)
def test_names_and_schema_follow_from_the_union(key, names, union):
    assert names == tuple(
        get_args(model.model_fields[key].annotation)[0] for model in get_args(union)
    )
    assert len(set(names)) == len(names)
    assert names_in_schema(key) == set(names)


@pytest.mark.parametrize("name", BUILT_IN_SENSORS)
def test_every_sensor_is_measured_as_the_page_says(name, card_of):
    fields = {"reference": {"file": "dance.npz"}} if name == "reference" else {}
    (spec,) = check_card(card_of({"o": {"sensor": name, **NEEDED.get(name, {})}}, **fields))
    (row,) = [line for line in PAGE.read_text().splitlines() if line.startswith(f"| `{name}` | (")]
    shape = row.split("|")[2]
    assert str(spec.dtype) in shape
    assert shape.split(")")[0].count(",") + (",)" not in shape) == len(spec.shape)


@pytest.mark.parametrize("name", BUILT_IN_WRAPPERS)
def test_every_wrapper_is_made(name):
    entry = {"wrapper": name, **NEEDED_BY_WRAPPERS.get(name, {})}
    (named,) = make_wrappers(TypeAdapter(list[Wrapper]).validate_python([entry]), code_from=None)
    assert named.name == name
    assert Chain("it", [named], Spec((6, 8, 3), "float32")).spec.shape
