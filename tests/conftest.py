"""What holds for every test: property tests draw the same examples each time.

A gate that sells repeatability may not have tests that fail one day in ten. New examples are drawn
by `HYPOTHESIS_PROFILE=explore make test`.
"""

import os
import signal

import pytest
from hypothesis import settings

from nw_base.machine_code import folder_note
from nw_policies.line import trusting

pytest_plugins = ("pytester",)  # Only this file may say so.

settings.register_profile("repeat", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeat"))

# What tests print and write is not for the runner that may run them.
for name in [name for name in os.environ if name.startswith("GITHUB_")]:
    del os.environ[name]

# What a test runs does run, and is taken over neither from another test's run nor from the user's.
# Tests of the cache of trials give it a size, and a folder of their own.
os.environ["NW_EVAL_CACHE_GB"] = "0"

# Whoever starts the tests in the background of a script has them ignore Ctrl-C, which some of them
# are about.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A process looks once where its kernels are kept. Were that in a test which has a cache of its own,
# all later tests of the process would compile theirs anew: 30 s for those of contacts alone.
folder_note()


@pytest.fixture(scope="session", autouse=True)
def _own_programs():
    """Open what a test wrote itself in its own process, as `--in-process` does."""
    with trusting():
        yield
