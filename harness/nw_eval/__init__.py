"""nw-eval: may this policy checkpoint ship?

    report = nw_eval.run("smoke", policy="go1-parkour", trials=1)

Every public name is stated in `__init__.pyi`, and is imported when it is first used.
"""

from __future__ import annotations

from types import MappingProxyType
from warnings import warn

from nw_base import __version__
from nw_base.public import public_names

_RENAMED = MappingProxyType(
    {
        "BankChange": "BaselineChange",
        "BlamePlan": "AttributionPlan",
        "BlameReport": "AttributionReport",
        "BlamedTrial": "AttributedTrial",
        "Blames": "Attribution",
        "SavedBank": "BaselineResults",
        "agree": "sim2real",
        "blame": "attribute",
    }
)
"""Names until 0.1, which are understood for one release."""

_public, __dir__, _names = public_names(__name__, __file__)
__all__ = ["__version__", *_names]  # noqa: PLE0604  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    if name in _RENAMED:
        new_name = _RENAMED[name]
        warn(f"nw_eval.{name} is now nw_eval.{new_name}", DeprecationWarning, stacklevel=2)
        return globals()[new_name] if new_name in globals() else _public(new_name)
    return _public(name)
