"""What pytest may be asked for about suites: options, their twins in its ini file, which files.

A session of other people's has YAML of its own, which is left alone.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

import pytest

Inconclusive = Literal["fail", "xfail", "pass"]
"""What becomes of a verdict that is INCONCLUSIVE."""

_WORDS: tuple[Inconclusive, ...] = get_args(Inconclusive)

_TWINS = {
    "policy": "the policy to judge: a shipped policy's name, a folder, or a card",
    "checkpoint": "use these weights instead of the card's",
    "baseline": "the baseline to compare with: a name, a file, or none (default: the suite's, if "
    "the policy is the suite's)",
    "rounds": "trials per scene, at most",
    "workers": "worker processes (default: one per core)",
    "report-dir": "the folder of run folders (default: reports/ of the project)",
}
"""Options that an ini file can set, too, and their help."""


def add_options(parser: pytest.Parser) -> None:
    """Tell pytest's parser of all options and of all keys of the ini file."""
    group = parser.getgroup("nw-eval", "nw-eval: suites as tests of a policy")
    for name, text in _TWINS.items():
        group.addoption(f"--nw-{name}", default=None, metavar=name.upper(), help=text)
        parser.addini(f"nw_{name.replace('-', '_')}", f"--nw-{name}: {text}", default="")
    group.addoption(
        "--nw-update-baseline",
        action="store_true",
        help="save the policy's results as the baseline, and fail, so that the change is reviewed",
    )
    group.addoption(
        "--nw-no-cache",
        action="store_true",
        help="run every trial, even if an earlier run has cached its result",
    )
    parser.addini("nw_suites", "folders and globs of YAML files that are suites", "args", [])
    words = " or ".join(_WORDS)
    parser.addini("nw_inconclusive", f"what INCONCLUSIVE is: {words} (fail)", default="")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What a session was asked for. None: the suite, or nw-eval, decides."""

    project: Path
    """Where names of policies, baselines and suites are looked for: the folder of pytest's ini
    file, or the one that pytest was started in."""
    report_dir: Path
    policy: str | None
    checkpoint: Path | None
    baseline: str | None
    rounds: int | None
    workers: int | None
    inconclusive: Inconclusive
    update_baseline: bool
    cache: bool
    suites: tuple[str, ...]
    started_in: Path
    arguments: tuple[str, ...]
    """What pytest was told to collect, as it was typed."""

    @classmethod
    def of(cls, config: pytest.Config) -> Settings:
        """Return the settings of a session; an option wins over its twin.

        Raises:
            pytest.UsageError: one of them cannot be used.
        """
        project = config.rootpath if config.inipath else config.invocation_params.dir
        values = {name: _value(config, name, project) for name in _TWINS}
        checkpoint, reports = values["checkpoint"], values["report-dir"]
        word = config.getini("nw_inconclusive") or "fail"
        if word not in _WORDS:
            raise pytest.UsageError(f"nw_inconclusive = {word}: give one of {', '.join(_WORDS)}")
        suites = tuple(config.getini("nw_suites"))
        for pattern in suites:
            if Path(pattern).is_absolute():
                raise pytest.UsageError(f"nw_suites = {pattern}: give a path below {project.name}/")
        return cls(
            project=project,
            report_dir=project / (reports or "reports"),
            policy=values["policy"],
            checkpoint=None if checkpoint is None else project / checkpoint,
            baseline=values["baseline"],
            rounds=_number("rounds", values["rounds"]),
            workers=_number("workers", values["workers"]),
            inconclusive=word,
            update_baseline=bool(config.getoption("nw_update_baseline")),
            cache=not config.getoption("nw_no_cache"),
            suites=suites,
            started_in=config.invocation_params.dir,
            arguments=tuple(config.args),
        )

    @cached_property
    def named(self) -> frozenset[Path]:
        """The files and folders of the command line.

        pytest itself forgets a file that is named beside its folder.
        """
        files = (argument.partition("::")[0] for argument in self.arguments)
        paths = (os.path.abspath(self.started_in / file) for file in files)  # noqa: PTH100 - pytest resolves no links.
        return frozenset(Path(path) for path in paths)

    @cached_property
    def declared(self) -> frozenset[Path]:
        """What the patterns of `nw_suites` match: files, and folders of files."""
        return frozenset(
            path.absolute() for pattern in self.suites for path in self.project.glob(pattern)
        )


SETTINGS = pytest.StashKey[Settings]()


def _value(config: pytest.Config, name: str, project: Path) -> str | None:
    """Return the value of an option or of its twin; a path means the same in every folder.

    A path of the command line starts where pytest was started, one of the ini file where that lies.
    """
    key = f"nw_{name.replace('-', '_')}"
    typed = config.getoption(key)
    value, start = (
        (config.getini(key), project) if typed is None else (typed, config.invocation_params.dir)
    )
    is_path = name in {"checkpoint", "report-dir"} or "/" in value
    if value and is_path and (name == "report-dir" or (start / value).exists()):
        return str(start / value)
    return value or None


def _number(name: str, value: str | None) -> int | None:
    if value is None:
        return None
    if not value.isascii() or not value.isdigit() or int(value) < 1:
        raise pytest.UsageError(f"--nw-{name} {value}: give a whole number, at least 1")
    return int(value)


_MOST = 1_000_000  # Bytes; as of a suite that is read.
_KEY = re.compile(rb"""^(?:\xef\xbb\xbf)?(?:\{\s*)?["']?nw-eval["']?\s*:""", re.MULTILINE)
"""The key that says of a YAML file that it is a suite."""


def is_suite(path: Path, config: pytest.Config) -> bool:
    """Return whether a file is to be taken for a suite, right or wrong.

    Any `*.nw.yaml` is, and what the ini file declares by `nw_suites`: such a file that is none is
    an error. Another YAML file is left alone, unless it was named on the command line and has the
    key `nw-eval`.
    """
    if path.suffix not in {".yaml", ".yml"}:
        return False
    if path.name.endswith(".nw.yaml"):
        return True
    settings = config.stash[SETTINGS]
    if not settings.declared.isdisjoint((path, *path.parents)):
        return True
    return path in settings.named and _has_key(path)


def _has_key(path: Path) -> bool:
    from nw_base.files.inside import regular

    try:
        with regular(path).open("rb") as file:
            return _KEY.search(file.read(_MOST)) is not None
    except OSError:
        return False
