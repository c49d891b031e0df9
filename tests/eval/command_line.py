"""Commands as they are typed, in this process."""

import pytest

from nw_eval.cli import main


def ends(*words):
    """Type a command, and return the exit code that it ends with."""
    with pytest.raises(SystemExit) as left:
        main([str(word) for word in words])
    return left.value.code
