"""Verbs on what a run is made of: suites, scenes, policies, sensors, splats."""
