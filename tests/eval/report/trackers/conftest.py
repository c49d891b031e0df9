"""One judged run for all trackers, whose names are a stranger's; nothing leaves the machine."""

from io import BytesIO

import pytest
from PIL import Image

from nw_eval.reporting.html.evidence import Clip
from nw_eval.reporting.trackers.tracked import tracked_run
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.results.provenance import PolicyInfo

HOSTILE = (
    "hurdles",  # The folder of the next.
    "hurdles/three_low",
    "hurdles/three low",
    "../../etc/passwd",
    "/abs",
    "a//b",
    "a/./b",
    "<b>![x](http://evil)</b>",
    "\u202egnp.exe",
    "\x1b[31mred",
    "ünïcode",
    "",
    "long" * 200,
    "long" * 200 + "er",
)


@pytest.fixture(autouse=True)
def at_home(monkeypatch, tmp_path):
    """Trackers that write here, and say nothing to anybody."""
    monkeypatch.chdir(tmp_path)
    for name, value in {
        "WANDB_MODE": "offline",
        "WANDB_DIR": str(tmp_path),
        "WANDB_DATA_DIR": str(tmp_path / "wandb-data"),
        "WANDB_CACHE_DIR": str(tmp_path / "wandb-cache"),
        "WANDB_CONFIG_DIR": str(tmp_path / "wandb-config"),
        "WANDB_ERROR_REPORTING": "false",
        "MLFLOW_TRACKING_URI": f"file:{tmp_path}/mlruns",
        "MLFLOW_ALLOW_FILE_STORE": "true",  # The skinny library has no other store of its own.
        "MLFLOW_DISABLE_TELEMETRY": "true",
        "DO_NOT_TRACK": "true",
    }.items():
        monkeypatch.setenv(name, value)
    for name in ("WANDB_RUN_ID", "WANDB_PROJECT", "WANDB_NAME", "MLFLOW_RUN_ID"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="session")
def clip():
    """Two frames of a trial whose name is a stranger's, as an animated WebP."""
    frames = [Image.new("RGB", (16, 9), colour) for colour in ("red", "blue")]
    data = BytesIO()
    frames[0].save(data, "WEBP", save_all=True, append_images=frames[1:], duration=100)
    return Clip(
        trial_id="a/<b>-000",
        mime="image/webp",
        data=data.getvalue(),
        width=16,
        height=9,
        seconds=0.2,
        caption="it `fell` <b>here</b>",
    )


@pytest.fixture
def tracked(clip, make_row, make_run, tmp_path):
    """Return a maker of tracked runs: two trials in each scene reached some of four waypoints."""

    def make(scenes=("hurdles/three_low", "b"), reached=2, **changes):
        names = dict.fromkeys(scenes, 2)
        rows = [
            make_row(scene, index, reached, trial_id=f"{number}-{index}")
            for number, scene in enumerate(names)
            for index in range(2)
        ]
        run = make_run(names, **changes)
        verdict = judge(rows, Gate(success_rate=0.9), names)
        page = tmp_path / "report.md"
        page.write_text("# A report\n")
        return tracked_run(run, verdict, tmp_path, (page,), [clip])

    return make


@pytest.fixture
def hostile(tracked):
    """A run of strangers' names."""
    policy = PolicyInfo(name="[p](http://evil) <b>`x`\n\x1b[31m", checkpoint_digest="cc" * 32)
    return tracked(HOSTILE, id="../r un\n'; DROP TABLE runs", policy=policy)
