"""What `nw-eval` can do with this package: train policies, and study how."""

from __future__ import annotations

from nw_base.verb import VerbTable

_TABLE = """
Train:
  train - how-to/training.md train a policy, or export one from a training
    teacher Teacher teacher
    student Student student-rgb-small
    export Export runs/teacher --out policies/mine
  study - how-to/studies.md train several kinds of students and compare them
    single-scene SingleSceneStudy single-scene-reduced
    multi-scene MultiSceneStudy --resume runs/my-study
    observations ObservationsStudy mine.yaml --out my-study
"""

VERBS = VerbTable(table=_TABLE, module=__name__, out_was_positional=frozenset({"train export"}))
