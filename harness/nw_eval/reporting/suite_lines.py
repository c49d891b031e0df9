"""Where a suite's file speaks of a scene: the line that a reader of a failure is led to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from nw_eval.results.provenance import RunInfo
from nw_eval.suite.check import folder_names


@dataclass(frozen=True, kw_only=True)
class SuiteLines:
    """A suite's file, and the line, from 1, of each scene and of the gate.

    A scene's line is that of the entry that names it, or else of the first glob that means it.
    """

    file: str
    """As seen from the folder that was asked for, with slashes."""
    scenes: Mapping[str, int]
    gate: int


def suite_lines(run: RunInfo, root: Path) -> SuiteLines | None:
    """Return the lines of a run's suite; None where its file is gone or not below a folder.

    Args:
        run: the run.
        root: the folder that paths are shown from: a repository's.
    """
    from nw_eval.files.yaml_file import YamlProblems, read_yaml

    name = Path(run.suite_file)
    path = (Path(run.suite_folder) / name.name if run.suite_folder else name).resolve()
    root = root.resolve()
    if not path.is_relative_to(root):
        return None
    try:
        file = read_yaml(path)
    except YamlProblems:
        return None
    entries = file.data.get("scenes")
    named = [str(entry) for entry in entries] if isinstance(entries, list) else []
    lines = [file.place(("scenes", index))[0] for index in range(len(named))]
    return SuiteLines(
        file=path.relative_to(root).as_posix(),
        scenes={
            scene: _line(scene, named, lines) or file.place(("scenes",))[0] for scene in run.scenes
        },
        gate=file.place(("gate",))[0],
    )


def _line(scene: str, named: list[str], lines: list[int]) -> int | None:
    """Return the line of the entry that means a scene: exact names win over globs and folders."""
    for means in (str.__eq__, fnmatchcase, _is_folder_of):
        for entry, line in zip(named, lines, strict=True):
            if means(scene, entry):
                return line
    return None


def _is_folder_of(scene: str, entry: str) -> bool:
    """Whether an entry is the path of a folder that a scene may be called after."""
    return scene in folder_names(entry)
