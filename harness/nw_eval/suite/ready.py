"""A suite file for places that have none yet."""

from __future__ import annotations

import re
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

from ruamel.yaml import YAML

from nw_eval.files.cache import atomic_path

_HEAD = """\
# go1-parkour is told the ground under it and needs no camera: `--policy` runs another one.
# Keys: docs/suites.md, and `nw-eval schema suite`.
"""
_LONGEST_NAME = 64


def write_ready_suite(path: Path, name: str, scenes: Sequence[str]) -> None:
    """Write a suite of scenes that `nw-eval run` takes as it is, whole or not at all.

    Args:
        path: of the file.
        name: of what it is about; what no suite's name may hold becomes a dash.
        scenes: as `scenes:` of a suite has them; paths start at the file.

    Raises:
        StoreError: it cannot be written.
    """
    text = {
        "nw-eval": 1,
        "name": re.sub(r"[^A-Za-z0-9_.-]", "-", name)[:_LONGEST_NAME],
        "robot": "go1",
        "policy": "go1-parkour",
        "trials": 10,
        "seed": 1,
        "scenes": list(scenes),
        "record": "failures",
        "gate": {"success_rate": 0.75, "confidence": 0.95},
    }
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None  # A list of names on one line.
    yaml.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    stream = StringIO(_HEAD)
    stream.seek(0, 2)
    yaml.dump(text, stream)
    with atomic_path(path) as temporary:
        temporary.write_text(stream.getvalue(), encoding="utf-8")
