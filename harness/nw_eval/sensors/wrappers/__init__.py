"""Wrappers: what a card puts between a sensor and the policy."""

from nw_eval.sensors.wrappers.chain import Chain, Named
from nw_eval.sensors.wrappers.link import Link, Shot, Spec
from nw_eval.sensors.wrappers.make import make_wrappers

__all__ = ["Chain", "Link", "Named", "Shot", "Spec", "make_wrappers"]
