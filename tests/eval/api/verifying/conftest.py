"""A run that has ended, as a folder of rows and logs that no simulation has made."""

from dataclasses import replace
from hashlib import sha256

import pytest
from saved_runs import info_of, row_of

from nw_base.trials import Trial
from nw_eval.suite import new_suite
from nw_gate.results.ended import write_trials
from nw_gate.results.journal import Journal, JournalHeader, read_journal
from nw_gate.results.provenance import (
    PolicyInfo,
    SceneInfo,
    code_info,
    machine_info,
    read_run_info,
    write_run_info,
)
from nw_gate.results.run_folder import RunFolder

SUITE = new_suite(
    {
        "nw-eval": 1,
        "name": "quick",
        "robot": "go1",
        "policy": "stand",
        "trials": 3,
        "seed": 5,
        "scenes": ["hurdles/one"],
        "gate": {"success_rate": 0.3},
    }
)
DIGEST = "dd" * 32
HEADER = JournalHeader(
    suite_digest=SUITE.digest, policy_digest="p", scene_digests={"hurdles/one": DIGEST}
)


def _row(folder, index):
    trial = Trial(
        suite="quick",
        suite_digest=SUITE.digest,
        suite_seed=5,
        scene="hurdles/one",
        scene_digest=DIGEST,
        task="hurdles",
        index=index,
    )
    log = folder.mcap(trial.scene, trial.id)
    log.parent.mkdir(parents=True, exist_ok=True)
    log.write_bytes(f"what happened in {index}".encode() * 100)
    return row_of(
        trial,
        1,
        end_reason="roll",
        mcap_path=folder.relative(log),
        mcap_bytes=log.stat().st_size,
        mcap_sha256=sha256(log.read_bytes()).hexdigest(),
    )


class EndedRun:
    """A run's folder, and what somebody who can write in it may do."""

    def __init__(self, path):
        self.folder = RunFolder(path=path)
        path.mkdir()
        self.rows = [_row(self.folder, index) for index in range(3)]

    @property
    def path(self):
        return self.folder.path

    @property
    def info(self):
        return read_run_info(self.folder.run_json)

    def write_journal(self, *rows):
        """Write the journal anew, with sums that are right."""
        self.folder.journal.unlink(missing_ok=True)
        with Journal.create(self.folder.journal, HEADER) as journal:
            for row in rows:
                journal.append(row)

    def write_info(self, **changes):
        """Write run.json anew, with a sum that is right."""
        write_run_info(self.folder.run_json, self.info.model_copy(update=changes))

    def end(self, *rows):
        """Write everything as if the run had ended with these rows: no sum is wrong."""
        ended = write_trials(self.folder, self.info, rows)
        write_run_info(self.folder.run_json, ended.model_copy(update={"finished": "later"}))

    def changed(self, index, **changes):
        """The run's rows, one of them changed."""
        rows = list(read_journal(self.folder.journal).rows)
        rows[index] = replace(rows[index], **changes)
        return rows


@pytest.fixture
def run(tmp_path):
    ran = EndedRun(tmp_path / "run")
    info = info_of(
        SUITE,
        {"hurdles/one": SceneInfo(digest=DIGEST, task="hurdles", trials=3)},
        policy=PolicyInfo(name="stand", checkpoint_digest="cc" * 32, card_digest="p"),
        code=code_info(),
        machine=machine_info(),
    )
    write_run_info(ran.folder.run_json, info)
    ran.write_journal(*ran.rows)
    ran.end(*ran.rows)
    return ran
