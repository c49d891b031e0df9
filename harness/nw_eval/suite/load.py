"""Suite files: finding, reading, and telling everything that is wrong with one at once."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from nw_eval.errors import Problem, SuiteError, UsageError, nearest
from nw_eval.inside import what_is
from nw_eval.shipped import available
from nw_eval.suite.model import Source, Suite, new_suite
from nw_eval.yaml_file import YamlProblems, read_yaml, validation_problems


def load_suite(name_or_path: str | Path, search: Path | None = None) -> Suite:
    """Read a suite by name or by path.

    Args:
        name_or_path: `hurdles` is `suites/hurdles.yaml` of the project, or the shipped one;
            whatever has a slash or ends in `.yaml` is a path.
        search: the project's folder, by default the working directory.

    Raises:
        UsageError: there is no such suite; names the nearest one.
        SuiteError: the file has problems, all of them told, each with its line and column.
    """
    path = find_suite(name_or_path, search)
    problems: list[Problem] = []
    try:
        file = read_yaml(path)
    except YamlProblems as error:
        if error.file is None:
            raise SuiteError(error.problems) from None
        # A duplicate key must not hide that another value is wrong: look at what was read, too.
        problems, file = list(error.problems), error.file
    try:
        suite = new_suite(file.data, Source(file=file.path, places=file.places))
    except ValidationError as error:
        # What could not be read stands as None, which is no second fault.
        lines = {problem.line for problem in problems}
        more = validation_problems(error, file, Suite)
        problems += [p for p in more if not (p.line in lines and "None" in p.message)]
    else:
        if not problems:
            return suite
    raise SuiteError(sorted(problems, key=lambda problem: (problem.line, problem.column)))


def find_suite(name_or_path: str | Path, search: Path | None = None) -> Path:
    """Return the path of a suite file.

    Raises:
        UsageError: there is no such suite; names the nearest one.
    """
    asked = str(name_or_path)
    known = available("suites", search)
    if asked in known:
        return known[asked]
    path = Path(asked)
    if search is not None and not path.is_absolute():
        path = search / path
    kind = what_is(path)
    if kind == "file":
        return path
    if kind == "folder":
        raise UsageError(f"{asked!r} is a folder, not a suite file", fix=nearest(asked, known))
    raise UsageError(f"no suite {asked!r}", fix=nearest(path.stem, known))
