"""TorchScript files that attack: behind the wall they write nothing and end nobody else."""

import numpy as np
import pytest
from torchscript import CARD, CRAFTED

from nw_base.confinement import offered
from nw_base.errors import NwEvalError
from nw_policies import load_bundle, open_policy
from nw_policies.line import line_to
from nw_sim.rollout.confined.access import policy_rules
from nw_sim.rollout.confined.start import PolicyProcess

PARTS = 4
"""Of the crafted files, each in a process of its own: one runs here, the others at night."""
SHOWN = {"body": np.zeros(12, dtype=np.float32)}


@pytest.mark.skipif(not (offered().landlock and offered().seccomp), reason="there is no fence")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    "part", [0, *(pytest.param(part, marks=pytest.mark.nightly) for part in range(1, PARTS))]
)
def test_no_crafted_script_writes_a_file_or_ends_its_caller(tmp_path, monkeypatch, part):
    came = {}
    some = dict(list(CRAFTED.items())[part::PARTS])
    for number, (name, make) in enumerate(some.items()):
        folder = tmp_path / str(number)
        folder.mkdir()
        monkeypatch.chdir(folder)
        (folder / "policy.pt").write_bytes(make())
        (folder / "policy.yaml").write_text(CARD.replace(", sha256: %s", ""))
        bundle = load_bundle(folder)
        with PolicyProcess(policy_rules(bundle)) as process, line_to(process.line):
            try:
                policy = open_policy(bundle)
                policy.reset(0)
                came[name] = policy.act(SHOWN).shape
            except NwEvalError as error:  # Its process may be gone, too.
                came[name] = str(error)
        assert sorted(path.name for path in folder.rglob("*")) == ["policy.pt", "policy.yaml"], name
    assert len(came) == len(some) > 3
    refused = [name for name, what in came.items() if isinstance(what, str)]
    assert refused, came
