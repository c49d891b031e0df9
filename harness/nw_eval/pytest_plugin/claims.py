"""Which files are suites: a session of other people's has YAML of its own."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from nw_eval.pytest_plugin.options import SETTINGS

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
    from nw_eval.files.inside import regular

    try:
        with regular(path).open("rb") as file:
            return _KEY.search(file.read(_MOST)) is not None
    except OSError:
        return False
