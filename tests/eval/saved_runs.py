"""Folders of runs as nw-eval saves them, with rows that no simulation has made."""

from nw_gate.results.ended import write_trials
from nw_gate.results.journal import Journal, JournalHeader
from nw_gate.results.provenance import CodeInfo, MachineInfo, PolicyInfo, RunInfo, write_run_info
from nw_gate.results.row import Row
from nw_gate.results.run_folder import RunFolder

MEASURED = {"physics_s": 0.5, "render_s": 1.0, "policy_s": 0.1, "log_s": 0.2, "wall_s": 2.0}


def row_of(trial, reached=4, **changes):
    """Return the row of a trial that reached some of four waypoints; None is a crash."""
    is_error = reached is None
    columns = {
        "trial_id": trial.id,
        "suite": trial.suite,
        "scene": trial.scene,
        "task": trial.task,
        "robot": "go1",
        "tier": trial.tier,
        "seed_index": trial.index,
        "seed": trial.seed,
        "policy": "stand",
        "status": "error" if is_error else "ok",
        "outcome": "crashed" if is_error else "completed" if reached == 4 else "fell",
        "end_reason": "error" if is_error else "waypoints",
        "completed": reached == 4,
        "success": None if is_error else reached / 4,
        "waypoints_reached": reached or 0,
        "waypoints_total": 4,
        "waypoint_times": tuple(map(float, range(reached or 0))),
        "steps": 200,
        "sim_s": 4.0,
        "checkpoint_digest": "cc" * 32,
        "scene_digest": trial.scene_digest,
    }
    return Row(**{**columns, **MEASURED, **changes})


def info_of(suite, scenes, /, **changes):
    """Return what run.json says of a run of a suite."""
    facts = {
        "id": "run",
        "started": "2026-11-21T11:00:05Z",
        "suite_file": f"{suite.name}.yaml",
        "suite": suite.model_dump(by_alias=True, mode="json"),
        "suite_digest": suite.digest,
        "policy": PolicyInfo(name="stand", checkpoint_digest="cc" * 32),
        "scenes": scenes,
        "code": CodeInfo(version="0.1.0", digest="ee" * 32),
        "machine": MachineInfo(host="ci", cpu="Some CPU", cores=2, system="Linux", python="3.11"),
        "versions": {"mujoco": "4.0.0"},
    }
    return RunInfo(**{**facts, **changes})


def save(path, info, rows, *, ended=True):
    """Write the folder of a run, which has ended or not; return it."""
    folder = RunFolder(path=path)
    path.mkdir(parents=True, exist_ok=True)
    write_run_info(folder.run_json, info)
    header = JournalHeader(
        suite_digest=info.suite_digest,
        policy_digest=info.policy.card_digest,
        scene_digests={name: scene.digest for name, scene in info.scenes.items()},
        engine=info.engine,
    )
    with Journal.create(folder.journal, header) as journal:
        for row in rows:
            journal.append(row)
    if ended:
        write_run_info(folder.run_json, write_trials(folder, info, rows))
    return folder
