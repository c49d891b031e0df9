"""Trials: a robot and a scene in MuJoCo, what its policy senses, its task, and its log."""

from __future__ import annotations
