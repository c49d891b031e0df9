"""scene.yaml as a person wrote it, with what a labelling decides changed in it and nothing else."""

from __future__ import annotations

import math
import re
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from nw_eval.errors import SceneError
from nw_eval.twin.label.placement import Placement
from nw_eval.twin.moved import similarity_entry
from nw_eval.twin.place import Route, rounded


class SceneText:
    """The content of a scene.yaml, checked already, its comments and spelling with it.

    Args:
        path: of the file.

    Raises:
        SceneError: it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._yaml, self._text = _round_trip(path)

    @property
    def splat(self) -> str | None:
        """The name of the splat's file; None = it has none."""
        return self._text.get("splat")

    def edit(
        self,
        course: Route,
        *,
        collision: str,
        captures: str | None,
        T_world_splat: NDArray[np.float64],
    ) -> str:
        """Return the text with what a labelling decides; what is as it was keeps its spelling."""
        _edit(self._text, course, collision, captures, T_world_splat)
        stream = StringIO()
        self._yaml.dump(self._text, stream)
        return stream.getvalue()


def _edit(
    text: CommentedMap,
    course: Route,
    collision: str,
    captures: str | None,
    T_world_splat: NDArray[np.float64],
) -> None:
    _put(text, "task", course.task)
    _put_trail(text, [rounded(point) for point in course.trail])
    spawn = text.setdefault("spawn", CommentedMap())
    _put(spawn, "position", rounded(course.spawn))
    yaw = math.remainder(course.yaw, 2 * math.pi)
    _put(spawn, "yaw", round(yaw, 4))
    if text.get("collision", "collision.yaml") != collision:
        text["collision"] = collision
    if captures is not None:
        _put(text, "captures", captures)
    if text.get("splat") is not None:
        entry = text.setdefault("T_world_splat", CommentedMap())
        if not np.allclose(Placement(**entry).matrix, T_world_splat, rtol=0.0, atol=1e-12):
            for name, value in similarity_entry(T_world_splat).items():
                _put(entry, name, value)


def _put(mapping: CommentedMap, name: str, value: Any) -> None:
    if name in mapping and _plain(mapping[name]) == _plain(value):
        return
    mapping[name] = _flow(value) if isinstance(value, list) else value


def _put_trail(text: CommentedMap, trail: list[list[float]]) -> None:
    """Replace points in place, so that comments between them stay."""
    points: Any = text["trail"]
    for i, point in enumerate(trail):
        if i >= len(points):
            points.append(_flow(point))
        elif _plain(points[i]) != point:
            comments = getattr(points[i], "ca", None)
            points[i] = _flow(point)
            if comments is not None:
                points[i].ca.comment = comments.comment
                points[i].ca.end = comments.end
    while len(points) > len(trail):
        points.pop()


def _plain(value: Any) -> Any:
    return [float(part) for part in value] if isinstance(value, list) else value


def _flow(values: list[float]) -> CommentedSeq:
    sequence = CommentedSeq(values)
    sequence.fa.set_flow_style()
    return sequence


def _round_trip(path: Path) -> tuple[YAML, CommentedMap]:
    """Return the content of a file, and what writes it in the same manner."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror or error}") from None
    yaml = YAML()  # The round trip's; folder_files has refused tags, and it runs none anyway.
    yaml.preserve_quotes = True
    yaml.width = 100
    if (item := re.search(r"^trail:.*\n(?: *#.*\n)*( +)- ", text, re.MULTILINE)) is not None:
        offset = len(item[1])
        yaml.indent(mapping=2, sequence=offset + 2, offset=offset)
    return yaml, yaml.load(text)
