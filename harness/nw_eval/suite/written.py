"""Suites as YAML text: the resolved one that runs and logs carry, and one for places without."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from io import StringIO
from math import ceil, prod
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

from ruamel.yaml import YAML

from nw_eval.errors import UsageError
from nw_eval.files.cache import atomic_path, followed
from nw_eval.suite.model import DRAFTED, Suite


def suite_yaml(suite: Suite) -> str:
    """Return a suite as the text of a file that loads to an equal suite, defaults written out."""
    return _yaml(_plain(suite.model_dump(by_alias=True)), default_flow_style=False)


def _yaml(values: Any, *, default_flow_style: bool | None) -> str:
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = default_flow_style
    yaml.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    stream = StringIO()
    yaml.dump(values, stream)
    return stream.getvalue()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in cast("dict[Any, Any]", value).items()}
    if isinstance(value, tuple):
        return [_plain(item) for item in cast("tuple[Any, ...]", value)]
    return value


_POLICIES: Mapping[str, str] = MappingProxyType(
    {"go1": "go1-parkour", "go2": "examples/himloco-go2"}
)
"""A policy of each robot that nw-eval has a card of and that needs no images."""
_ABOUT: Mapping[str, str] = MappingProxyType(
    {
        "go1": """\
# go1-parkour is told the ground under it and needs no camera: `--policy` runs another one.
""",
        "go2": """\
# himloco-go2 is blind. Its weights are not shipped, and `nw-eval check` says where they are:
# `--checkpoint` names them, `--policy` runs another one.
""",
    }
)


_HEAD = """\
# Keys: docs/reference/suite.md, and `nw-eval schema suite`.
"""


_LONGEST_NAME = 64
_FEWEST = 10  # trials in each scene


def robot_from(folder: Path, robot: str) -> str:
    """Return what names a robot in a suite of a folder, where its paths start.

    Args:
        folder: of the suite.
        robot: a name, or a path from the working directory.
    """
    if ":" in robot or "/" not in robot:
        return robot
    path = Path(os.path.relpath(robot, folder)).as_posix()
    return path if path.startswith("../") else f"./{path}"


def check_has_policy(robot: str) -> None:
    """Check that nw-eval knows a policy of a robot, which a suite without another one names.

    Raises:
        UsageError: it knows none.
    """
    if robot not in _POLICIES:
        raise UsageError(
            f"nw-eval has no policy of the robot {robot!r} to name in the scene's suite",
            fix="leave the robot out here, and then: nw-eval scenes check SCENE --robot ROBOT "
            "--policy POLICY --out FILE",
        )


def write_ready_suite(
    path: Path,
    name: str,
    scenes: Sequence[str],
    *,
    robot: str = "go1",
    policy: str | None = None,
    perturb: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> None:
    """Write a suite of scenes that `nw-eval run` takes as it is, whole or not at all.

    It has twice the trials that its bar needs of a policy that never fails, and 10 in each scene at
    least: a policy that fails now and then can pass, too.

    Args:
        path: of the file.
        name: of what it is about; what no suite's name may hold becomes a dash.
        scenes: as `scenes:` of a suite has them, one at least; paths start at the file.
        robot: that runs in it; a path starts at the file (`robot_from`).
        policy: as above, without `--policy`; one that nw-eval has a card of if None.
        perturb: values of axes of perturbation.

    Raises:
        UsageError: nw-eval has no policy of the robot, and none is named.
        StoreError: it cannot be written.
    """
    # What makes rows imports this file, and counts no statistics among its code.
    from nw_eval.stats.betting import trials_to_certify

    gate = {"success_rate": 0.75, "confidence": 0.95}
    cells = prod(len(values) for values in perturb.values())
    needed = ceil(trials_to_certify(gate["success_rate"], gate["confidence"]) / len(scenes) / cells)
    if policy is None:
        check_has_policy(robot)
    text: dict[str, Any] = {
        "nw-eval": 1,
        "name": re.sub(r"[^A-Za-z0-9_.-]", "-", name)[:_LONGEST_NAME],
        "robot": robot,
        "policy": policy or _POLICIES[robot],
        "trials": max(_FEWEST, 2 * needed),
        "seed": 1,
        "scenes": list(scenes),
        "render": DRAFTED.model_dump(),
        "record": "failures",
        "gate": gate,
    }
    if perturb:
        text["perturb"] = {axis: list(values) for axis, values in perturb.items()}
    head = _ABOUT.get(robot, "") + _HEAD if policy in {None, _POLICIES.get(robot)} else _HEAD
    # None: a list of names on one line.
    content = head + _yaml(text, default_flow_style=None)
    with atomic_path(followed(path)) as temporary:
        temporary.write_text(content, encoding="utf-8")
