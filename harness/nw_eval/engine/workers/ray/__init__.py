"""Trials on the nodes of a Ray cluster: the worker processes of the local engine, elsewhere.

connection.py  join a cluster, or start one on this machine; the only module that imports ray
parcels.py     what travels to nodes, by content: policy, scenes, compiled splats
received.py    where a node keeps what it got, and the check that it is what was sent
node.py        what a node is asked: what it is, to make ready, to tidy up
seat.py        one worker process on a node, with Ray's process between it and the cluster
library.py     scenes and policies in that process, by the names that the head has for them
nodes.py       the head's view of the nodes: asked, refused, ready, lost
logs.py        logs that came back, written into the run's folder
workers.py     the queue: seats on nodes that are ready, jobs to seats, results back

Policies never share a process with Ray: a seat is an actor that owns a confined child, the same one
that the local engine starts, so that limits, fences, faults and bits are the same.
"""
