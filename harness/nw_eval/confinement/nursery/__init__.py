"""Processes that are forked from one that has imported what they need, each in some milliseconds.

handle.py   the nursery as its owner sees it: `Nursery`, and a `Child` for each process
process.py  what runs in the nursery: import, fork, and say how a child ended

`multiprocessing` has a fork server, which would not do. It listens at an address where a policy
that has left its fence could have it start a process without one; it collects the dead at once, so
that their numbers, by which groups are killed, may belong to somebody else; and each child keeps it
alive when its owner is gone. This one has a pair of sockets and no address.
"""

from nw_eval.confinement.nursery.handle import Child, Nursery

__all__ = ["Child", "Nursery"]
