"""Public names of a package, imported when they are first used.

A package states them once, in its `__init__.pyi`, which editors and type checkers read, too.


    from nw_base.public import public_names

    __getattr__, __dir__, __all__ = public_names(__name__, __file__)

The stub has lines such as `from nw_splat.render import CpuRenderer as CpuRenderer`: the form by
which a stub makes a name public. `from nw_eval.api import *` takes all of another package's stub.
"""

from __future__ import annotations

import sys
from importlib import import_module

TYPE_CHECKING = False  # As of `typing`, which takes longer to import than all else here.
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


def homes(stub: str) -> dict[str, str]:
    """Return in which module each public name of a stub, by its path, is at home."""
    with open(stub, encoding="utf-8") as file:  # noqa: PTH123  # pathlib would be loaded for it.
        text = file.read()
    modules: dict[str, str] = {}
    for line in f"\n{text}".split("\nfrom ")[1:]:
        module, _, names = line.partition(" import ")
        listed = names.partition(")" if names.startswith("(") else "\n")[0].split(",")
        if listed == ["*"]:
            root = stub.rsplit("/", 2)[0]
            modules |= homes(f"{root}/{module.replace('.', '/')}/__init__.pyi")
        elif module.startswith("nw_"):
            each = (name.strip("( \n").partition(" as ")[0] for name in listed)
            modules |= {name: module for name in each if name}
    return modules


def public_names(
    package: str, file: str, renamed: Mapping[str, str] | None = None
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package.

    Args:
        package: its `__name__`.
        file: its `__file__`; beside it lies the stub, `__init__.pyi`.
        renamed: names by earlier ones, which are understood for one release. Whoever uses an
            earlier one gets a `DeprecationWarning` that says the new one.
    """
    earlier = renamed or {}
    known = homes(f"{file}i")

    def get(name: str) -> object:
        if name in earlier:
            from warnings import warn

            now = earlier[name]
            warn(f"{package}.{name} is now {package}.{now}", DeprecationWarning, stacklevel=2)
            return getattr(sys.modules[package], now)
        if name not in known:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(known[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *known})

    return get, listed, list(known)
