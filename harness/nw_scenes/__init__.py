"""Scenes: what physics touches, what rays meet, what cameras see, and the course through them.

Robots (`robots`), and what is fetched from and pushed to a hub (`hub`), are here, too.
"""

from nw_base.public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)  # pyright: ignore[reportUnsupportedDunderAll]
