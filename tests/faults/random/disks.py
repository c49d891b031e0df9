"""Disks that are full and folders that cannot be written, where this system lets us mount them."""

import os
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

_WITHIN = "NW_EVAL_FAULTS_MOUNTS"
_OWN = ["unshare", "--user", "--map-root-user", "--mount", "--propagation", "private"]

_PATIENCE = 10.0
"""Seconds."""


def enter_namespace():
    """Begin this program again where it may mount, if there is such a place; else go on here."""
    if _WITHIN in os.environ:
        return
    try:
        can = not subprocess.run([*_OWN, "true"], capture_output=True, check=False).returncode
    except OSError:
        can = False
    words = [sys.executable, *sys.argv]
    if can:
        os.execvpe(_OWN[0], [*_OWN, *words], {**os.environ, _WITHIN: "1"})


@cache
def may_mount():
    """Tell whether disks can be mounted and folders protected here: by doing both."""
    if os.environ.get(_WITHIN) != "1":
        return False
    with tempfile.TemporaryDirectory(prefix="nw-eval-disk-", ignore_cleanup_errors=True) as name:
        mounted, protected = Path(name) / "mounted", Path(name) / "protected"
        protected.mkdir()
        try:
            disk(mounted, size=4096 * 4)
            enlarge(mounted)
            write_protect(
                protected, patience=0.0
            )  # Some systems have disks, and nothing remounted read-only.
        except (OSError, subprocess.CalledProcessError):
            return False
        finally:
            forget(mounted)
            forget(protected)
    return True


def disk(folder, size):
    """Make a folder a disk of so many bytes."""
    folder.mkdir()
    _run("mount", "-t", "tmpfs", "-o", f"size={size}", "disk", str(folder))


def enlarge(folder):
    _run("mount", "-o", "remount,size=256m", str(folder))


def write_protect(folder, patience=_PATIENCE):
    """Let nothing below a folder be opened for writing; what is open remains so."""
    _run("mount", "--bind", str(folder), str(folder))
    deadline = time.monotonic() + patience
    while True:
        try:
            _run("mount", "-o", "remount,bind,ro", str(folder))
        except subprocess.CalledProcessError:
            # Busy: a log was opened for writing since the line before, and will be closed.
            if time.monotonic() > deadline:
                raise
            time.sleep(0.01)
        else:
            return


def release(folder):
    _run("umount", "--lazy", str(folder))


def forget(folder):
    """Take disks away, of which several may lie over each other."""
    while folder.is_mount():
        release(folder)


def _run(*words):
    subprocess.run(words, check=True, capture_output=True)
