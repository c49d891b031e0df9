"""docs/policies.md names what the code has: every key, adapter, term and command source."""

import re
from pathlib import Path
from typing import get_args

import pytest

from nw_eval.policies.card import ADAPTERS, Card, Control
from nw_eval.policies.observations import BUILT_IN_SENSORS, BaseObservation, ProprioObservation
from nw_eval.policies.observations.proprio import History
from nw_eval.policies.terms import AnyTerm

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "policies.md").read_text()
TERMS = [get_args(term.model_fields["term"].annotation)[0] for term in get_args(AnyTerm)]
OPTIONS = ("depth_every", "steer_by_depth", "heads", "ensemble", "query_every", "url", "digest")


@pytest.mark.parametrize(
    "name",
    [
        *Control.model_fields,
        *TERMS,
        *ADAPTERS,
        *BUILT_IN_SENSORS,
        *BaseObservation.model_fields,
        *OPTIONS,
    ],
)
def test_it_names(name):
    assert re.search(rf"`{name}\b", PAGE) or re.search(rf"`{name}`", PAGE)


def test_it_has_every_key_of_a_card_and_of_histories():
    keys = {field.alias or name for name, field in Card.model_fields.items()}
    for key in keys | set(ProprioObservation.model_fields) - {"sensor"}:
        assert re.search(rf"\b{key}\b", PAGE), key
    for key in set(History.model_fields) - {"zero"}:
        assert re.search(rf"\b{key}:", PAGE), key
