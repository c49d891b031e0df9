"""JSON Schemas of the files that people write, for editors."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from nw_base.words import Described
from nw_eval.api.paths import as_path

if TYPE_CHECKING:
    from os import PathLike


def schema(kind: Described, *, out: str | PathLike[str] | None = None) -> dict[str, Any]:
    """Return the JSON Schema of suites, cards, `scene.yaml`, a scene's boxes, or `ladder.yaml`.

    Args:
        kind: the kind of file: a suite, a policy card, scene.yaml, a scene's box file, or
            ladder.yaml.
        out: also write it here as JSON (default: write none).

    Raises:
        StoreError: it cannot be written.
    """
    from nw_base.files.cache import atomic_path, followed

    out = as_path(out)
    described = _schema(kind)
    if out is not None:
        with atomic_path(followed(out)) as temporary:
            temporary.write_text(json.dumps(described, indent=2) + "\n", encoding="utf-8")
    return described


def _schema(kind: Described) -> dict[str, Any]:
    if kind == "suite":
        from nw_eval.suite import json_schema as of_suite

        return of_suite()
    if kind == "policy":
        from nw_policies.cards.load import json_schema as of_card

        return of_card()
    if kind == "ladder":
        from nw_scenes.ladder_file import json_schema as of_ladder

        return of_ladder()
    from nw_scenes.folder import json_schema as of_scene

    return of_scene(kind)
