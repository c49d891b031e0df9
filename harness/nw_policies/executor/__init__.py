"""Networks with the same bits on every processor, planned once and run by one compiled kernel.

graph.py       operators with named inputs and outputs
program.py     a network's computation as rows of whole numbers, and their check
plan.py        plans a graph
network.py     runs a program
joining.py     several programs in one arena
planning.py    gives values their floats in one arena, and operators their rows
moves.py, arithmetic.py, products.py, recurrent.py    what each operator becomes
views.py       offset, shape and strides
kernels.py, functions.py    the interpreter of rows, and its functions

`network` imports Numba; what is named here does not.
"""

from nw_policies.executor.graph import (
    NEXT,
    Graph,
    GraphInput,
    Node,
    RecordedFile,
    UnsupportedError,
)
from nw_policies.executor.program import IDENTITY, VERSION, Program

__all__ = [
    "IDENTITY",
    "NEXT",
    "VERSION",
    "Graph",
    "GraphInput",
    "Node",
    "Program",
    "RecordedFile",
    "UnsupportedError",
]
