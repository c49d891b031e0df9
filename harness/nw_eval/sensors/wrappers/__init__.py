"""Wrappers: what a card puts between a sensor and the policy."""

from nw_eval.sensors.wrappers.chain import Chain, NamedWrapper
from nw_eval.sensors.wrappers.make import make_wrappers
from nw_eval.sensors.wrappers.wrapper import Shot, Spec, Wrapper

__all__ = ["Chain", "NamedWrapper", "Shot", "Spec", "Wrapper", "make_wrappers"]
