"""JSON Schemas of the files that people write, for editors."""

from __future__ import annotations

import json
from typing import Any, Literal

Kind = Literal["suite", "policy", "scene", "collision"]


def schema(kind: Kind) -> str:
    """Return the JSON Schema of suites, cards, `scene.yaml`, or a scene's file of boxes."""
    return json.dumps(_schema(kind), indent=2)


def _schema(kind: Kind) -> dict[str, Any]:
    if kind == "suite":
        from nw_eval.suite import json_schema as of_suite

        return of_suite()
    if kind == "policy":
        from nw_eval.cards.file.schema import json_schema as of_card

        return of_card()
    from nw_eval.scenes.folder import json_schema as of_scene

    return of_scene(kind)
