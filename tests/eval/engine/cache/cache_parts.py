"""Trials, their rows and their logs, as entries of a cache are made of them."""

from collections import deque
from dataclasses import dataclass, replace

from nw_base.trials import expand
from nw_eval.engine.cache import Conditions
from nw_eval.engine.order import in_order
from nw_eval.engine.pool import Finished
from nw_eval.engine.rows import make_row
from nw_eval.suite.model import new_suite
from nw_sim.rollout.job import TrialJob, TrialResult

DONE = TrialResult(
    status="ok",
    outcome="completed",
    waypoints_reached=1,
    waypoints_total=1,
    waypoint_times=(1.0,),
    steps=50,
    wall_seconds=2.0,
)


@dataclass(frozen=True)
class Place:
    name: str
    task: str = "flat"
    digest: str = "d"


def conditions_of(**changes):
    known = {"policy": "p", "engine": {"mujoco": "4.0.0", "cpu": "znver4"}, "system": {"libc": "2"}}
    return Conditions(**known | changes)


def jobs_of(folder, *, trials=1, scenes=("flat/a",), is_drawn=False):
    """Return the jobs of a suite of so many trials in each scene, in their order or a drawn one."""
    suite = new_suite(
        {
            "nw-eval": 1,
            "name": "tiny",
            "robot": "go1",
            "policy": "p",
            "trials": trials,
            "seed": 1,
            "scenes": list(scenes),
        }
    )
    drawn = [(name, (), index) for index in range(trials) for name in scenes] if is_drawn else None
    return [
        TrialJob(
            trial=trial,
            robot="go1",
            scene=trial.scene,
            duration=1.0,
            policy="p",
            checkpoint_digest="c",
            mcap=folder.mcap(trial.scene, trial.id),
        )
        for trial in in_order(expand(suite, [Place(name) for name in scenes], drawn))
    ]


def finish(job, result=DONE):
    """Write the log of a trial; return what the trial has come to, which says how long it is."""
    log = f"the log of {job.trial.id}".encode()
    job.mcap.parent.mkdir(parents=True, exist_ok=True)
    job.mcap.unlink(missing_ok=True)
    job.mcap.write_bytes(log)
    return replace(result, mcap_bytes=len(log))


def row_of(job, folder, result=DONE):
    return make_row(job, finish(job, result), attempt=1, policy="p", folder=folder)


class Office:
    """Hires workers that simulate nothing: `results` says what trials come to, `DONE` the rest."""

    again = "somewhere else"

    def __init__(self, results=None):
        self.results = {name: deque(made) for name, made in (results or {}).items()}
        self.started = []

    def __call__(self, *_, **__):
        return Hands(self)


class Hands:
    def __init__(self, office):
        self.office, self.queue = office, deque()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.queue.clear()

    def submit(self, jobs):
        self.queue.extend(jobs)

    def finished(self):
        while self.queue:
            job = self.queue.popleft()
            self.office.started.append(job.trial.id)
            made = self.office.results.get(job.trial.id)
            yield Finished(job=job, result=finish(job, made.popleft() if made else DONE))

    def stop(self):
        self.queue.clear()
