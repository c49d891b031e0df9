"""Scores: declared numbers of a trial, one file a family."""

from nw_eval.scores.registry import score_class, score_names, specs_of
from nw_eval.scores.score import Figures, MissingReadingError, Score, ScoreSpec, Stretch, TrialEnd

__all__ = [
    "Figures",
    "MissingReadingError",
    "Score",
    "ScoreSpec",
    "Stretch",
    "TrialEnd",
    "score_class",
    "score_names",
    "specs_of",
]
