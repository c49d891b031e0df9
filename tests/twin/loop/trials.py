"""How policies do in a twin against its original: by its own trail, and by the original's."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from ruamel.yaml import YAML

from nw_eval import api
from nw_sim.catalogue import get_scene

POLICIES = ("go1-act-rgb", "go1-parkour")
"""One that sees the splat, and one that feels the ground ahead of it."""
_SEED = 11


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Of a policy's trials in a place.

    Attributes:
        success: mean share of waypoints reached.
        failing: the waypoint that most of its failures did not reach, 1 = the first; None where
            none failed.
        failures: trials that did not reach all of them.
        trials: that came to a result.
    """

    success: float
    failing: int | None
    failures: int
    trials: int


def carry(twin, out, scene, T_twin_original):
    """Write a twin's folder again with the start and the trail of its original; return it."""
    out.mkdir(parents=True, exist_ok=True)
    yaml = YAML(typ="safe")
    text = yaml.load((twin / "scene.yaml").read_text())
    for file in (text["collision"], text["splat"], text["captures"]):
        (out / file).unlink(missing_ok=True)
        (out / file).hardlink_to(twin / file)
    T = T_twin_original
    ahead = T[:3, :3] @ (np.cos(scene.spawn.yaw), np.sin(scene.spawn.yaw), 0.0)
    text["trail"] = (scene.trail @ T[:3, :3].T + T[:3, 3]).tolist()
    text["spawn"] = {
        "position": (T[:3, :3] @ scene.spawn.position + T[:3, 3]).tolist(),
        "yaw": float(np.arctan2(ahead[1], ahead[0])),
    }
    text["name"] += "_carried"
    text["task"] = scene.task
    with (out / "scene.yaml").open("w") as file:
        yaml.dump(text, file)
    return out


def outcomes(places, policy, out, *, duration, trials=20, workers=1):
    """Return the outcome of a policy in each place, by what the places are called here.

    Args:
        places: scenes by name or folder.
        policy: shipped.
        out: folder of the suite and its run.
        duration: of a trial at most, s.
        trials: of each place.
        workers: processes.
    """
    out.mkdir(parents=True, exist_ok=True)
    names = {
        key: place if isinstance(place, str) else str(place.resolve())
        for key, place in places.items()
    }
    text = {
        "nw-eval": 1,
        "name": "loop",
        "robot": "go1",
        "policy": policy,
        "trials": trials,
        "seed": _SEED,
        "scenes": list(names.values()),
        "episode": {"duration": duration},
        "render": {"projection": "ray"},
    }
    suite = out / "loop.yaml"
    with suite.open("w") as file:
        YAML(typ="safe").dump(text, file)
    rows = api.run(suite, out=out / "run", workers=workers, all_rounds=True).rows
    scenes = {key: get_scene(name).name for key, name in names.items()}
    return {key: tallied([row for row in rows if row.scene == scenes[key]]) for key in places}


def tallied(rows):
    """Return what rows of a policy in one place come to; errors are not counted."""
    rows = [row for row in rows if row.status == "ok"]
    failed = Counter(row.waypoints_reached + 1 for row in rows if not row.completed)
    return Outcome(
        success=float(np.mean([row.success for row in rows])) if rows else float("nan"),
        failing=max(failed, key=lambda one: (failed[one], -one)) if failed else None,
        failures=failed.total(),
        trials=len(rows),
    )
