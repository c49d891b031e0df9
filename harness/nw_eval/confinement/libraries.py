"""What Python and its libraries read on their own, wherever they run."""

from __future__ import annotations

import os
import site
import sys
from pathlib import Path

# Programs' and libraries' own files; what the loader and the C library ask; what NumPy, torch and
# onnxruntime ask about the processor. Nothing of a user, and no list of other processes.
_SYSTEM = (
    "/usr",
    "/lib",
    "/lib64",
    "/nix/store",
    "/etc/ld.so.cache",
    "/etc/localtime",
    "/etc/nsswitch.conf",
    "/proc/self",
    "/proc/cpuinfo",
    "/proc/meminfo",
    "/proc/stat",
    "/proc/sys/vm",
    "/sys/devices/system",
    "/sys/bus/pci/devices",
    "/sys/fs/cgroup",
    "/dev/urandom",
    "/dev/random",
)
_NETWORK = (
    "/etc/resolv.conf",
    "/etc/hosts",
    "/etc/host.conf",
    "/etc/gai.conf",
    "/etc/services",
    "/etc/ssl",
    "/etc/pki",
    "/run/systemd/resolve",
)

DEVICES = tuple(Path(name) for name in ("/dev/null", "/dev/zero"))
"""Which may be written, too."""


def library_paths(*, network: bool) -> tuple[Path, ...]:
    """Return files and folders that this process's libraries read.

    Args:
        network: whether names of hosts and certificates are among them.
    """
    # What stands first is the folder of the script, or where somebody happened to be.
    imported = sys.path if sys.flags.safe_path else sys.path[1:]
    names = [
        *_SYSTEM,
        *(_NETWORK if network else ()),
        *(sys.prefix, sys.exec_prefix, sys.base_prefix, sys.base_exec_prefix),
        *(site.getusersitepackages() if site.ENABLE_USER_SITE else "",),
        *imported,
        *os.environ.get("LD_LIBRARY_PATH", "").split(":"),
        str(Path(__file__).resolve().parents[1]),
    ]
    return tuple(dict.fromkeys(Path(name) for name in names if name))
