import csv

from nw_eval import Reporter


def write(run, path):
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["scene", "trials", "completed", "success"])
        for score in run.verdict.per_scene:
            table.writerow([score.scene, score.n, score.completed, score.mean])


REPORTER = Reporter(name="csv", writes="CSV table", target="file", report=write)
