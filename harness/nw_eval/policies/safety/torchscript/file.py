"""TorchScript files: checked without torch, and written anew for torch."""

from __future__ import annotations

import re

from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.policies.safety.kind import file_kind, kind_said
from nw_eval.policies.safety.limits import FileLimits
from nw_eval.policies.safety.members import SCRIPT_MEMBERS, canonical
from nw_eval.policies.safety.objects import read_index
from nw_eval.policies.safety.tensors import check_references, checked_tree, leaves
from nw_eval.policies.safety.torchscript.body import GUARDS
from nw_eval.policies.safety.torchscript.script import check_type, rewrite
from nw_eval.policies.safety.torchscript.words import Definitions

_GUARDS_MEMBER = f"code/{GUARDS.replace('.', '/')}.py"


def check_torchscript(data: bytes, where: str, limits: FileLimits | None = None) -> bytes:
    """Check a TorchScript file as far as it can be without running it.

    Its members, their sizes, that every tensor lies inside the numbers that the file holds, that
    its objects are of its own classes, and that its code is a network's.

    Returns:
        The file as torch may load it: written anew from what was checked. It gives the same
        actions, bit for bit.

    Raises:
        PolicyError: it is not TorchScript file, or fails a check.
    """
    limits = limits or FileLimits()
    kind = file_kind(data, where)
    if kind != "torchscript":
        raise PolicyError(
            f"{where}: not a TorchScript file: {kind_said(kind)}",
            fix="save the module with torch.jit.save, or change `adapter`",
        )
    archive, index = checked_tree(data, where, limits, SCRIPT_MEMBERS)
    for _ in leaves(index.tree, where, limits):
        pass  # Walking them checks their number and their total size.
    check_references(index, archive, "data", limits)
    raw = archive.read("constants.pkl", at_most=limits.index_bytes)
    constants = read_index(raw, where, limits)
    check_references(constants, archive, "constants", limits)
    for name in sorted({"version", ".data/version"}.intersection(archive.names())):
        if not re.fullmatch(rb"[0-9]{1,4}\s*", archive.read(name, at_most=64)):
            raise PolicyError(
                f"{where}: its `{name}` is not a number", fix="export the policy again"
            )
    code = {
        name: archive.read(name, at_most=limits.code_bytes)
        for name in archive.names()
        if name.startswith("code/") and name.endswith(".py")
    }
    if _GUARDS_MEMBER in code:
        raise PolicyError(
            f"{where}: its member {_GUARDS_MEMBER!r} has a name that is taken",
            fix="do not use this file; export the policy again",
        )
    rewritten, known = rewrite(code, where, limits)
    _check_classes(index.classes | constants.classes, known, where)
    for kind in sorted(index.types | constants.types):
        check_type(kind, known, where)
    if any(GUARDS in text for text in rewritten.values()):
        from nw_eval.policies.safety.guards import guards_code

        rewritten[_GUARDS_MEMBER] = guards_code()
    return canonical(archive, rewritten)


def _check_classes(names: frozenset[str], known: Definitions, where: str) -> None:
    for name in sorted(names):
        if known.kinds.get(name) != "class":
            raise PolicyError(
                f"{where}: it has an object of `{clean(name, at_most=80)}`, a class that "
                "its code does not define",
                fix="export the plain network, without custom classes",
            )
