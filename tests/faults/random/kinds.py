"""Kinds of faults: the run that each hits, how, and the exit codes that are true then."""

import signal
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import disks
from caches import (
    corrupted_entries,
    corrupted_splats,
    entries_corrupted_in_mid_run,
    removed_cache,
)
from clusters import has_ray, lost_raylet
from hits import (
    CHILD,
    HOARD,
    LIMIT,
    STOP,
    call_raises,
    full_disk,
    no_longer_files,
    ordered,
    removed_folder,
    resumed_while_it_runs,
    signal_to_parent,
    signal_to_workers,
    stopped_for_a_while,
    torn_journal,
    two_resumes,
    write_protected,
    write_protected_resume,
)

USAGE, FAULT, INTERRUPTED = 2, 4, 130
KILLED = -signal.SIGKILL


@dataclass(frozen=True)
class Kind:
    """A kind of fault: the run that it hits, how, and the codes that are true then.

    A fault may come after the end: a verdict is true always.
    """

    origin: str
    hit: Callable
    codes: frozenset = frozenset()
    needs: Literal["nothing", "mounts", "Ray"] = "nothing"
    daily: bool = True


KINDS = {
    "SIGKILL parent, alone": Kind("alone", signal_to_parent(signal.SIGKILL), {KILLED}),
    "SIGTERM parent, alone": Kind("alone", signal_to_parent(signal.SIGTERM), {INTERRUPTED}),
    "SIGINT parent, alone": Kind("alone", signal_to_parent(signal.SIGINT), {INTERRUPTED}),
    "SIGSTOP parent, alone": Kind("alone", stopped_for_a_while("parent")),
    "torn journal": Kind("alone", torn_journal, {KILLED}),
    "removed folder": Kind("alone", removed_folder, {FAULT}),
    "file size limit": Kind("alone", no_longer_files, {FAULT}),
    "full disk": Kind("alone", full_disk, {FAULT}, needs="mounts"),
    "read-only in mid-run": Kind("alone", write_protected, {FAULT}, needs="mounts"),
    "read-only resume": Kind("alone", write_protected_resume, {FAULT}, needs="mounts"),
    "two resumes at once": Kind("alone", two_resumes, {FAULT}),
    "resumed while it runs": Kind("alone", resumed_while_it_runs, {FAULT}),
    "a call: disk error": Kind("alone", call_raises("disk"), {USAGE, FAULT}),
    "a call: any error": Kind("alone", call_raises("runtime"), {USAGE, FAULT}),
    "a call: exit": Kind("alone", call_raises("exit"), {USAGE, FAULT}),
    "SIGKILL parent": Kind("network", signal_to_parent(signal.SIGKILL), {KILLED}, daily=False),
    "SIGKILL group": Kind("workers", signal_to_parent(signal.SIGKILL, to_group=True), {KILLED}),
    "SIGTERM parent": Kind("workers", signal_to_parent(signal.SIGTERM), {INTERRUPTED}),
    "SIGTERM group": Kind(
        "workers", signal_to_parent(signal.SIGTERM, to_group=True), {INTERRUPTED}, daily=False
    ),
    "SIGINT parent": Kind("workers", signal_to_parent(signal.SIGINT), {INTERRUPTED}, daily=False),
    "SIGINT group": Kind(
        "network", signal_to_parent(signal.SIGINT, to_group=True), {INTERRUPTED}, daily=False
    ),
    "SIGKILL a worker": Kind(
        "network", signal_to_workers(signal.SIGKILL, every=False), daily=False
    ),
    "SIGKILL all workers": Kind(
        "network", signal_to_workers(signal.SIGKILL, every=True), daily=False
    ),
    "SIGTERM a worker": Kind(
        "network", signal_to_workers(signal.SIGTERM, every=False), daily=False
    ),
    "SIGSEGV a worker": Kind("network", signal_to_workers(signal.SIGSEGV, every=False)),
    "SIGABRT all workers": Kind(
        "network", signal_to_workers(signal.SIGABRT, every=True), daily=False
    ),
    "SIGSTOP group": Kind("workers", stopped_for_a_while("group"), daily=False),
    "SIGSTOP workers": Kind("network", stopped_for_a_while("workers"), daily=False),
    "removed cache": Kind("rendered", removed_cache, daily=False),
    "corrupted splats": Kind("rendered", corrupted_splats, daily=False),
    "corrupted cache entries": Kind("cached", corrupted_entries),
    "entries corrupted in mid-run": Kind("cached", entries_corrupted_in_mid_run, daily=False),
    "lost raylet": Kind("network", lost_raylet, needs="Ray", daily=False),
    "native abort": Kind("obeying", ordered("os.abort()"), daily=False),
    "native fault": Kind("obeying", ordered("ctypes.string_at(0)"), daily=False),
    "policy exits": Kind("obeying", ordered("os._exit(0)"), daily=False),
    "worker stopped for good": Kind("obeying", ordered(STOP, "--time-limit", 8)),
    "memory limit": Kind("obeying", ordered(HOARD, *LIMIT)),
    "memory limit, a child": Kind("obeying", ordered(CHILD, *LIMIT), daily=False),
}


def possible():
    """Return the kinds that this system allows, in an order that is always the same."""
    there = {"nothing": True, "mounts": disks.may_mount(), "Ray": has_ray()}
    return [name for name, kind in KINDS.items() if there[kind.needs]]
