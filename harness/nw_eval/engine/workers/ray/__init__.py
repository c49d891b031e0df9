"""Trials on the nodes of a Ray cluster: the worker processes of the local engine, elsewhere.

connection.py  join a cluster, or start one on this machine; the only module that imports ray
parcels.py     what travels to nodes, by content: policy, scenes, compiled splats
received.py    where a node keeps what it got, and the check that it is what was sent
node.py        what a node is asked: what it is, to make ready, to tidy up
station.py     the worker processes of a node, with one of Ray's between them and the cluster
library.py     scenes and policies in that process, by the names that the head has for them
nodes.py       the head's view of the nodes: asked, refused, ready, lost
logs.py        logs that came back, written into the run's folder
workers.py     the queue: stations on nodes that are ready, jobs to them, results back

Policies never share a process with Ray: a station is an actor that owns confined processes, those
that the local engine starts, so that limits, fences, faults and bits are the same. There is one for
a node, and not for a core: its workers are forked from one process that has imported what they
need, share their pages, and keep to their scenes as on one machine.
"""
