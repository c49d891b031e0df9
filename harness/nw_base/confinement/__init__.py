"""Processes that open untrusted files: confined before the first of these is opened.

fence.py        what a process may do, its memory and time; `confine` makes it so; Landlock and
                seccomp together, what libraries read on their own, what it came to
seccomp.py      which system calls are allowed, for whom, and their numbers
rights.py       what is given up first: capabilities, threads without end
kernel.py       calls that Python has no function for
family.py       parents, children and the terminal; what children inherit
fork_server.py  children that need not import anything
"""

from nw_base.confinement.family import (
    GONE,
    LEFT,
    child_environment,
    interrupts_blocked,
    kill_group,
    without_script,
)
from nw_base.confinement.fence import (
    Fence,
    Rules,
    confine,
    fence_stands,
    memory_to_open,
    memory_to_run,
    offered,
    processor_time,
    raise_fence,
)
from nw_base.confinement.fork_server import Child, ForkServer

__all__ = [
    "GONE",
    "LEFT",
    "Child",
    "Fence",
    "ForkServer",
    "Rules",
    "child_environment",
    "confine",
    "fence_stands",
    "interrupts_blocked",
    "kill_group",
    "memory_to_open",
    "memory_to_run",
    "offered",
    "processor_time",
    "raise_fence",
    "without_script",
]
