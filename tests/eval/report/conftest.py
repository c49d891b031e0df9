import pytest

from nw_gate.results.provenance import CodeInfo, MachineInfo, PolicyInfo, RunInfo, SceneInfo
from nw_gate.results.row import Row
from nw_gate.stats.baseline.curve import CurvePoint
from nw_gate.stats.interval import Interval
from nw_gate.verdict import Comparison, SceneDrop

SUITE = """\
nw-eval: 1
name: hurdles
robot: go1
policy: go1-parkour
trials: 4
seed: 7
scenes:
  - hurdles/one
  - "gaps/*"
  - places/kitchen
gate:
  success_rate: 0.75
"""


@pytest.fixture
def evil():
    """What a stranger may call a thing: escapes, a new line, an order, Markdown, HTML, a turn."""
    return (
        "\x1b[2Jred\u202e\u2066 a\n::error::owned\r\n##[error]x %0A::stop-commands::y "
        "**bold** _low_ `code` [a](http://b) | <script>alert(1)</script> <!-- x --> &lt; "
        "@maintainer #12 :tada: ]]> \x00\ufffe\ud800"
    )


@pytest.fixture
def suite_file(tmp_path):
    """A suite in a repository, the folder of which is `suite_file.parents[1]`."""
    path = tmp_path / "repository" / "suites" / "hurdles.yaml"
    path.parent.mkdir(parents=True)
    path.write_text(SUITE, encoding="utf-8")
    return path


@pytest.fixture
def of_suite(suite_file):
    """What run.json says of that suite, for `make_run`."""
    return {"suite_file": "suites/hurdles.yaml", "suite_folder": str(suite_file.parent)}


@pytest.fixture
def regressed():
    """A comparison that is REGRESSED, by the mean and by its one scene, which is critical."""
    fell = SceneDrop(
        scene="hurdles/three_low", tier="critical", baseline=0.95, candidate=0.4, trials=5,
        evidence=2.5e6, named=True, waypoint=2,
    )  # fmt: skip
    return Comparison(
        word="REGRESSED", baseline_name="shipped", policy="go1-act-rgb", basis="panel",
        claim="fresh", trials=80, budget=320, starts=60, mean_regressed=True, false_alarm=0.07,
        baseline=0.925, drop=0.25, interval=Interval(0.12, 0.41),
        max_drop=0.1, tolerate=0.02, scene_drop=0.1, alpha_pass=0.05, alpha_regr=0.01,
        scenes=(fell,), reasons=("worse than the baseline shipped",),
        curve=(
            (CurvePoint(drop=0.0, passed=0.995, regressed=0.0, trials=64.0),),
            (CurvePoint(drop=0.05, passed=0.64, regressed=0.36, trials=128.0),),
            (CurvePoint(drop=0.1, passed=0.04, regressed=0.9, trials=96.0),),
        ),
    )  # fmt: skip


@pytest.fixture
def make_row():
    """A row of trial `index` in a scene, which reached some of four waypoints; None is a crash."""

    def make(scene, index, reached, **changes):
        trial = f"{scene.replace('/', '-')}-{index:03d}"
        columns = {
            "trial_id": trial,
            "suite": "hurdles",
            "scene": scene,
            "task": "hurdles",
            "robot": "go1",
            "seed_index": index,
            "seed": index,
            "policy": "go1-parkour",
            "status": "error" if reached is None else "ok",
            "outcome": "crashed" if reached is None else "completed" if reached == 4 else "fell",
            "end_reason": "" if reached is None else "waypoints" if reached == 4 else "roll",
            "completed": reached == 4,
            "success": None if reached is None else reached / 4,
            "waypoints_reached": reached or 0,
            "waypoints_total": 4,
            "waypoint_times": tuple(map(float, range(reached or 0))),
            "steps": 200,
            "sim_s": 4.0,
            "physics_s": 0.5,
            "render_s": 1.0,
            "policy_s": 0.1,
            "log_s": 0.2,
            "wall_s": 2.0,
            "coverage_min": 0.98,
            "coverage_mean": 0.99,
            "checkpoint_digest": "cc" * 32,
            "scene_digest": "dd" * 32,
            "mcap_path": f"mcap/{scene}/{trial}.mcap",
            "error_text": "" if reached is not None else "signal 11",
        }
        return Row(**{**columns, **changes})

    return make


@pytest.fixture
def make_run():
    """Provenance of a run of two workers that took a minute."""

    def make(planned, **changes):
        facts = {
            "id": "hurdles-go1-parkour-20261121T110005Z-01234567",
            "started": "2026-11-21T11:00:05Z",
            "finished": "2026-11-21T11:01:05Z",
            "wall_s": 60.0,
            "suite_file": "suites/hurdles.yaml",
            "suite": {"name": "hurdles"},
            "suite_digest": "aa" * 32,
            "policy": PolicyInfo(name="go1-parkour", checkpoint_digest="cc" * 32),
            "scenes": {
                name: SceneInfo(digest="dd" * 32, task="hurdles", trials=count)
                for name, count in planned.items()
            },
            "workers": 2,
            "renderer": "cpu gsplat-1.5",
            "code": CodeInfo(version="0.1.0", digest="ee" * 32, commit="f" * 40, dirty=True),
            "machine": MachineInfo(
                host="ci", cpu="Some CPU", cores=2, system="Linux x86_64", python="3.11.7"
            ),
            "versions": {"mujoco": "4.0.0"},
        }
        return RunInfo(**{**facts, **changes})

    return make
