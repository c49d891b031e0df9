"""Published Neverwhere scenes, read in place.

scene = load_published("neverwhere:/data/real_scenes/hurdle_stata_v1")
inspection = inspect_published("/data/real_scenes/hurdle_stata_v1")
"""

from nw_eval.scenes.neverwhere.load import (
    PREFIX,
    Inspection,
    inspect_published,
    load_published,
    reference_path,
)

__all__ = ["PREFIX", "Inspection", "inspect_published", "load_published", "reference_path"]
