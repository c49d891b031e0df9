"""What the stages of a build have made, as a scene folder that suites can name."""

from nw_eval.twin.place.write import SUITE, Route, write_place

__all__ = ["SUITE", "Route", "write_place"]
