"""What all figures of studies share: their sizes, their colours, how they are written."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.files.cache import atomic_path

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from nw_eval.learn.studies.plan import Part

COLOURS: dict[Part, str] = {"training": "#0072B2", "evaluation": "#E69F00"}
"""Blue and orange of Okabe and Ito (2008), which people with any colour vision tell apart."""

WIDTH = 8.0
"""Of a figure, inches; 800 pixels."""

_LONGEST = 60


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100, metadata={"Software": None})


def folded(name: str, width: int) -> str:
    """Return a name, such as a scene's, in lines of so many letters."""
    words = clean(name, at_most=_LONGEST).replace("/", " ").replace("_", " ")
    return textwrap.fill(words, width)
