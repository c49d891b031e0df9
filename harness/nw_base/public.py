"""Public names of a package, imported when they are first used.

A package states them once, in its `__init__.pyi`, which editors and type checkers read, too.


    from nw_base.public import public_names

    __getattr__, __dir__, __all__ = public_names(__name__, __file__)

The stub has lines such as `from nw_splat.render import CpuRenderer`, and `__all__`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

_IMPORT = re.compile(r"^from (nw_[\w.]+) import (?:\(([^)]*)\)|(.+))$", re.MULTILINE)


def homes(stub: Path) -> dict[str, str]:
    """Return in which module each public name of a stub is at home."""
    found: dict[str, str] = {}
    for module, several, one in _IMPORT.findall(stub.read_text(encoding="utf-8")):
        names = [name.strip() for name in (several or one).split(",")]
        found |= {name: module for name in names if name}
    return found


def public_names(
    package: str, file: str
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package.

    Args:
        package: its `__name__`.
        file: its `__file__`; beside it lies `__init__.pyi`.
    """
    known = homes(Path(file).with_suffix(".pyi"))

    def get(name: str) -> object:
        if name not in known:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(known[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *known})

    return get, listed, list(known)
