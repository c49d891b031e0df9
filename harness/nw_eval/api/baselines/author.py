"""Who saves a bank."""

from __future__ import annotations

import getpass
import subprocess


def author() -> str:
    """Return the name that Git would write into a commit here, or else the user's; or nothing."""
    try:
        done = subprocess.run(
            ["git", "config", "user.name"],  # noqa: S607  # Whichever git the user has.
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        try:
            return getpass.getuser()
        except (OSError, KeyError):  # A container's user may have no name.
            return ""
    return done.stdout.strip()
