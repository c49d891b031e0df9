"""Which members a torch archive may have, and the same archive written anew from them.

Torch's own reader of archives looks members up without regard to case, takes its root from the
first of them, and looks for more of them than any policy has. So it is given an archive of ours:
what was checked, under the names that were checked, and nothing else.
"""

from __future__ import annotations

import re

from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.policies.safety.archive import Archive

_NAME = "[A-Za-z_][A-Za-z_0-9]*"
_CODE = rf"code/__torch__(/{_NAME})*\.py"
_STATE = r"data\.pkl|data/[0-9]+|version|\.data/version|byteorder"
_MARKS = r"\.format_version|\.storage_alignment|\.data/serialization_id"
"""What torch notes about an archive, and nobody needs."""
STATE_MEMBERS = re.compile(f"{_STATE}|{_MARKS}")
"""Members of a state dict."""
SCRIPT_MEMBERS = re.compile(
    rf"{_STATE}|{_MARKS}|constants\.pkl|constants/[0-9]+|{_CODE}"
    rf"|{_CODE}\.debug_pkl|extra/.*|traced_inputs(\.pkl|/[0-9]+)"
)
"""Members of a TorchScript file; those of the last line are for people, and left out."""
_KEPT = re.compile(rf"{_STATE}|constants\.pkl|constants/[0-9]+|{_CODE}")
_MOBILE = re.compile(r"bytecode\.pkl|mobile_debug_handles\.pkl|.*\.ff|.*\.ptl", re.IGNORECASE)


def check_members(archive: Archive, allowed: re.Pattern[str]) -> None:
    """Check that all members lie in one folder and are those of their kind, case and all.

    Raises:
        PolicyError: a member is another, or lies elsewhere.
    """
    where = archive.where
    if not archive.root:
        raise PolicyError(
            f"{where}: the archive's members do not lie in one folder, as those of torch do",
            fix="do not use this file; export the policy again",
        )
    for name in archive.names():
        if allowed.fullmatch(name):
            continue
        mobile = _MOBILE.fullmatch(name) is not None
        raise PolicyError(
            f"{where}: the archive has a member {clean(name, at_most=200)!r}, which "
            + ("is for torch's mobile interpreter" if mobile else "such a file does not have"),
            fix="save the module with torch.jit.save alone"
            if mobile
            else "do not use this file; export the policy again",
        )
