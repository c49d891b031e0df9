"""What the functions of an ONNX file become when onnxruntime writes them out where they are called.

Thirty functions, each of which calls the one before it twice, are a billion nodes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from nw_eval.clean import clean
from nw_eval.errors import PolicyError

Operator = tuple[str, str, str]
"""Domain, name and overload of an operator or function."""

_NESTED = 64
"""Functions that call functions: exporters write one for each module of a network."""


def check_calls(
    functions: Mapping[Operator, Counter[Operator]],
    main: Counter[Operator],
    most: int,
    where: str,
) -> None:
    """Check that a graph stays small when every call is replaced by its function's nodes.

    Args:
        functions: how often each function of the file has each operator.
        main: likewise the main graph.
        most: nodes that the graph, or a function on its own, may become.
        where: the file, for errors.

    Raises:
        PolicyError: a function calls itself, through others perhaps; calls are nested deeper than
            exporters nest them; there are more nodes than `most`.
    """
    known: dict[Operator, tuple[int, int]] = {}  # Nodes, and how deep calls are nested.

    def written_out(calls: Counter[Operator], path: tuple[Operator, ...]) -> tuple[int, int]:
        nodes = depth = 0
        for key, times in calls.items():
            if key in functions and key not in known:
                if key in path:
                    raise PolicyError(
                        f"{where}: the function {operator_said(key)} calls itself", fix=_FIX
                    )
                if len(path) < _NESTED:
                    known[key] = written_out(functions[key], (*path, key))
            inner, below = known.get(key, (0, _NESTED if key in functions else -1))
            nodes += times * (1 + inner)
            depth = max(depth, below + 1)
        if depth > _NESTED:
            raise PolicyError(f"{where}: over {_NESTED} functions call each other", fix=_FIX)
        if nodes > most:
            raise PolicyError(
                f"{where}: over {most} nodes when its functions are written out", fix=_FIX
            )
        return nodes, depth

    for key, calls in functions.items():
        if key not in known:
            known[key] = written_out(calls, (key,))
    written_out(main, ())


def operator_said(key: Operator) -> str:
    """Return an operator as errors say it: `domain::name`."""
    domain, name, _ = key
    return repr(clean(f"{domain}::{name}" if domain else name, at_most=100))


_FIX = "export the policy again, its actor alone and without functions of its own"
