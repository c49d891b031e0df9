"""nw-eval: may this policy checkpoint ship?

    report = nw_eval.run("smoke", policy="go1-parkour", trials=1)

Every public name is stated in `__init__.pyi`, and is imported when it is first used.
"""

from __future__ import annotations

from types import MappingProxyType

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

__getattr__, __dir__, _names = public_names(__name__, __file__, _RENAMED)
__all__ = ["__version__", *_names]  # noqa: PLE0604  # pyright: ignore[reportUnsupportedDunderAll]
