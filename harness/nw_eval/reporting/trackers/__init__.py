"""Trackers of experiments: a judged run shown on the run of its checkpoint.

`tracked.py` says once what all of them get; a module each says how one gets it. Each is imported
when it is asked for, and none is needed for anything else.
"""
