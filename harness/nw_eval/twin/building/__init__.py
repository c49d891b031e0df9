"""All stages of a twin, one after another, each only where its result is not there already."""

from nw_eval.twin.building.settings import BuildSettings
from nw_eval.twin.building.stages import Build

__all__ = ["Build", "BuildSettings"]
