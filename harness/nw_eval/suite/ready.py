"""A suite file for places that have none yet."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ruamel.yaml import YAML

from nw_eval.files.cache import atomic_path, followed

_POLICY = "go1-parkour"
_ABOUT_POLICY = """\
# go1-parkour is told the ground under it and needs no camera: `--policy` runs another one.
"""
_HEAD = """\
# Keys: docs/suites.md, and `nw-eval schema suite`.
"""
_LONGEST_NAME = 64


def write_ready_suite(
    path: Path,
    name: str,
    scenes: Sequence[str],
    *,
    robot: str = "go1",
    policy: str = _POLICY,
    perturb: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> None:
    """Write a suite of scenes that `nw-eval run` takes as it is, whole or not at all.

    Args:
        path: of the file.
        name: of what it is about; what no suite's name may hold becomes a dash.
        scenes: as `scenes:` of a suite has them; paths start at the file.
        robot: that runs in it.
        policy: likewise, without `--policy`.
        perturb: values of axes of perturbation.

    Raises:
        StoreError: it cannot be written.
    """
    text: dict[str, Any] = {
        "nw-eval": 1,
        "name": re.sub(r"[^A-Za-z0-9_.-]", "-", name)[:_LONGEST_NAME],
        "robot": robot,
        "policy": policy,
        "trials": 10,
        "seed": 1,
        "scenes": list(scenes),
        "record": "failures",
        "gate": {"success_rate": 0.75, "confidence": 0.95},
    }
    if perturb:
        text["perturb"] = {axis: list(values) for axis, values in perturb.items()}
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None  # A list of names on one line.
    yaml.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    stream = StringIO(_ABOUT_POLICY + _HEAD if policy == _POLICY else _HEAD)
    stream.seek(0, 2)
    yaml.dump(text, stream)
    with atomic_path(followed(path)) as temporary:
        temporary.write_text(stream.getvalue(), encoding="utf-8")
