"""A capture and its depths in, Gaussians out: the stage of a build that makes the splat."""

from nw_eval.twin.appearance.options import AppearanceOptions
from nw_eval.twin.appearance.stage import AppearanceReport, train_splat

__all__ = ["AppearanceOptions", "AppearanceReport", "train_splat"]
