"""The log of one second of walking, with pictures."""

import pytest

from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.trial import run_trial


@pytest.fixture(scope="session")
def walked_log(make_job, library, tmp_path_factory):
    path = tmp_path_factory.mktemp("walked") / "walked.mcap"
    result = run_trial(make_job(mcap=path, record="all", duration=1.0), library=library)
    assert (result.status, result.mcap_error) == ("ok", "")
    return path


@pytest.fixture(scope="session")
def messages(walked_log):
    """Return the log's messages by topic: (time in ns, message) each."""
    found = {}
    for topic, time, message in LogReader(walked_log).messages():
        found.setdefault(topic, []).append((time, message))
    return found
