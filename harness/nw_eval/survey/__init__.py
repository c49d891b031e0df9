"""A place gone along before a robot does: what its camera will see, and what its feet will meet."""

from nw_eval.survey.scene import Survey, survey_scene

__all__ = ["Survey", "survey_scene"]
