"""One trial's loop from observation to physics, and who looks on."""

from nw_eval.rollout.episode.episode import Episode
from nw_eval.rollout.episode.observer import Decision, Observer, Step

__all__ = ["Decision", "Episode", "Observer", "Step"]
