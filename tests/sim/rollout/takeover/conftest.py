"""Recorded trials that others take over, and a policy that remembers."""

import hashlib
import io

import pytest
import torch
from torch import nn

from nw_sim.rollout.record import attachments
from nw_sim.rollout.trial import run_trial


class Remembering(nn.Module):
    """A recurrent policy, whose memory is a buffer."""

    def __init__(self):
        super().__init__()
        self.rnn = nn.GRUCell(36, 8)
        self.out = nn.Linear(8, 12)
        self.register_buffer("hidden", torch.zeros(1, 8))

    def forward(self, body: torch.Tensor) -> torch.Tensor:
        self.hidden = self.rnn(body, self.hidden)
        return torch.tanh(self.out(self.hidden))


# Everything that a policy can have between its answer and the motors: its own rate, units, latency
# and filter, and other motors than the shipped policy's.
REMEMBERING = """\
nw-policy: 1
name: remembers
robot: go1
adapter: torchscript
checkpoint: {file: net.pt, sha256: SHA}
control: {action: joint_position, rate: 25, scale: 0.5, delay_steps: 2, kp: 35, kd: 0.8,
          filter: {kind: butterworth, cutoff: 5}}
observations:
  body: {sensor: proprio, terms: [joint_pos, joint_vel, last_output]}
"""


@pytest.fixture(scope="session")
def remembering(tmp_path_factory):
    """Return the folder of a policy with a memory, a rate, a latency and a filter of its own."""
    folder = tmp_path_factory.mktemp("remembers")
    buffer = io.BytesIO()
    with torch.random.fork_rng():
        torch.manual_seed(5)
        torch.jit.save(torch.jit.script(Remembering().eval()), buffer)
    (folder / "net.pt").write_bytes(buffer.getvalue())
    sha = hashlib.sha256(buffer.getvalue()).hexdigest()
    (folder / "policy.yaml").write_text(REMEMBERING.replace("SHA", sha))
    return str(folder)


NETWORKED = """\
nw-policy: 1
name: networked
robot: go1
adapter: zero
control:
  action: joint_position_offset
  motors:
    - {joints: [hip, thigh], kind: network, file: motor.pt, history: [0, 1]}
    - {joints: calf, kind: dc, saturation_torque: 30, no_load_speed: 30, delay: 3}
"""


@pytest.fixture(scope="session")
def networked(tmp_path_factory):
    """Return the folder of a policy whose motors are a network, and others with a delay."""
    folder = tmp_path_factory.mktemp("networked")
    module = nn.Sequential(nn.Linear(4, 1)).eval()
    with torch.no_grad():  # N m for errors, rad, and velocities, rad/s, of two steps.
        module[0].weight[:] = torch.tensor([[30.0, 10.0, -0.4, -0.2]])
        module[0].bias[:] = 0.0
    torch.jit.script(module).save(str(folder / "motor.pt"))
    (folder / "policy.yaml").write_text(NETWORKED)
    return str(folder)


@pytest.fixture(scope="session")
def record(make_job, library, tmp_path_factory):
    """Return a function that runs a trial and returns its log and its result."""

    def run(policy="go1-parkour", **settings):
        path = tmp_path_factory.mktemp("log") / "trial.mcap"
        bundle = library.bundle(policy, settings.get("checkpoint"))
        job = make_job(
            policy=policy,
            mcap=path,
            policy_name=bundle.name,
            attachments=attachments(bundle.card_text, "suite: of a test\n"),
            **settings,
        )
        result = run_trial(job, library=library)
        assert result.status == "ok", result.error_text
        return path, result

    return run


@pytest.fixture(scope="session")
def walked(record):
    """Return log and result of a second in which the shipped policy walks."""
    return record(duration=1.0)
