"""What runs a checkpoint, whatever file it came from.

A card (`cards`) and its checkpoint make a `Bundle`; `open_policy` makes a `Policy` of it, which
turns observations into raw actions. `executor` runs networks with the same bits everywhere;
`drafting` writes cards for what people bring.
"""

from nw_base.public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)  # pyright: ignore[reportUnsupportedDunderAll]
