"""Whose fault a failure is, and since when: a baseline takes over."""
