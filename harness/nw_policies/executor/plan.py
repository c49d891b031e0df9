"""Plans graphs by all operators that there are."""

from __future__ import annotations

from nw_policies.executor import arithmetic, moves, products, recurrent
from nw_policies.executor.graph import Graph
from nw_policies.executor.planning import Planner
from nw_policies.executor.program import Program

OPERATORS = (arithmetic, moves, products, recurrent)
"""Modules of operators: importing them registers what a `Planner` knows."""


def plan(graph: Graph) -> Program:
    """Return the program that computes a graph with the same bits on every processor.

    Raises:
        UnsupportedError: an operator, or a use of one, cannot be planned; named.
    """
    return Planner(graph).plan()
