"""The JSON Schema of policy cards, every key with its meaning."""

from __future__ import annotations

from typing import Any

from nw_eval.cards.card import Card
from nw_eval.files.json_schema import json_schema_of


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a policy card."""
    return json_schema_of(Card)
