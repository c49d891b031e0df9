"""A suite back as YAML text: the resolved suite that runs and logs carry with them."""

from __future__ import annotations

from io import StringIO
from typing import Any, cast

from ruamel.yaml import YAML

from nw_eval.suite.model import Suite


def suite_yaml(suite: Suite) -> str:
    """Return a suite as the text of a file that loads to an equal suite, defaults written out."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    stream = StringIO()
    yaml.dump(_plain(suite.model_dump(by_alias=True)), stream)
    return stream.getvalue()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in cast("dict[Any, Any]", value).items()}
    if isinstance(value, tuple):
        return [_plain(item) for item in cast("tuple[Any, ...]", value)]
    return value
