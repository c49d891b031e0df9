from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from saved_runs import save

from nw_eval.api.saved_run import saved_suite, saved_trials
from nw_eval.reporting.html.evidence import (
    NO_EVIDENCE,
    Clip,
    LogEvidence,
    PlacePicture,
    PlaceView,
    WalkedPath,
)
from nw_eval.reporting.html.page import render_html
from nw_eval.reporting.tables import NO_RIVALS
from nw_eval.suite import Gate, new_suite
from nw_gate.absolute import judge
from nw_gate.baseline.combine import combined
from nw_gate.verdict import SceneDrop

_EMPTY = {"meta", "link", "img", "br", "input"}


class Element:
    """An element of a page, with its children and the text right within it."""

    def __init__(self, tag, attributes):
        self.tag = tag
        self.attributes = attributes
        self.parts = []

    def all(self, tag=None, **attributes):
        return [
            each
            for each in self._below()
            if tag in {None, each.tag}
            and all(
                each.attributes.get(name.strip("_").replace("_", "-")) == is_
                for name, is_ in attributes.items()
            )
        ]

    def one(self, tag=None, **attributes):
        (found,) = self.all(tag, **attributes)
        return found

    @property
    def text(self):
        return "".join(part if isinstance(part, str) else part.text for part in self.parts).strip()

    @property
    def cells(self):
        """Of a table: its rows, the header first."""
        return [
            [cell.text for cell in row.all() if cell.tag in {"th", "td"}] for row in self.all("tr")
        ]

    def _below(self):
        for part in self.parts:
            if isinstance(part, Element):
                yield part
                yield from part._below()


NO_BREAK = "\u00a0"
"""Between a number and its unit; here as any other space."""


class _Reader(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open = [Element("", {})]

    def handle_starttag(self, tag, attrs):
        assert len(dict(attrs)) == len(attrs), (tag, attrs)
        told = {name: value and value.replace(NO_BREAK, " ") for name, value in attrs}
        self.open[-1].parts.append(element := Element(tag, told))
        if tag not in _EMPTY:
            self.open.append(element)

    def handle_startendtag(self, tag, attrs):
        self.open[-1].parts.append(Element(tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop().tag == tag, f"</{tag}> closes another element"

    def handle_data(self, data):
        self.open[-1].parts.append(data.replace(NO_BREAK, " "))


@pytest.fixture
def read():
    """Parse a page; every element must be closed where it ought to be."""

    def reading(text):
        reader = _Reader()
        reader.feed(text)
        reader.close()
        assert len(reader.open) == 1, [each.tag for each in reader.open]
        return reader.open[0]

    return reading


@pytest.fixture
def make_page(make_run):
    """The page of some rows, judged by a bar."""

    def make(rows, evidence=NO_EVIDENCE, *, gate=None, against=None, rivals=NO_RIVALS, **facts):
        planned = {scene: sum(row.scene == scene for row in rows) for scene in _scenes(rows)}
        verdict = judge(rows, gate or Gate(success_rate=0.75), planned, against=against)
        verdict = verdict if against is None else combined(verdict, against)
        return render_html(
            make_run(planned, **facts),
            rows,
            verdict,
            Path("reports/run one"),
            evidence,
            rivals=rivals,
        )

    return make


@pytest.fixture
def compared(regressed):
    """What five rounds in two scenes show: one fell at its second waypoint, the other did not."""
    high = SceneDrop(
        scene="hurdles/high", tier="critical", baseline=0.95, candidate=0.45, trials=5,
        evidence=2.5e6, named=True, waypoint=2, ends=([0, 1, 1, 0, 18], [0, 3, 1, 0, 1]),
    )  # fmt: skip
    low = SceneDrop(
        scene="hurdles/low", tier="supporting", baseline=0.9, candidate=1.0, trials=5,
        evidence=0.3, named=False, ends=([2, 0, 0, 0, 18], [0, 0, 0, 0, 5]),
    )  # fmt: skip
    return replace(
        regressed, claim="panel", trials=10, budget=40, starts=20, drop=0.2, scenes=(low, high),
        curve=None,
    )  # fmt: skip


@pytest.fixture
def full_evidence():
    """As much as logs could ever hold of some trials: long paths, large pictures and clips."""

    def make(rows):
        rng = np.random.Generator(np.random.PCG64(7))
        return LogEvidence(
            paths=tuple(
                WalkedPath(
                    trial_id=row.trial_id,
                    points=np.cumsum(rng.normal((0.01, 0.0), 0.01, (600, 2)), axis=0),
                )
                for row in rows
            ),
            places=tuple(
                PlaceView(
                    scene=scene,
                    waypoints=np.array([[1.0, 0.0], [2.5, 0.4]]),
                    reach=0.3,
                    picture=PlacePicture(
                        mime="image/webp", data=rng.bytes(40_000),
                        west=-1.0, east=5.0, south=-2.0, north=2.0,
                    ),
                )
                for scene in _scenes(rows)
            ),
            clips=tuple(
                Clip(
                    trial_id=row.trial_id, mime="image/webp", data=rng.bytes(250_000),
                    still=rng.bytes(20_000), width=320, height=180, seconds=2.5,
                    caption="What the camera saw before the end.",
                )
                for row in rows[:12]
            ),
        )  # fmt: skip

    return make


def _scenes(rows):
    return sorted({row.scene for row in rows})


@pytest.fixture
def save_run(make_run, make_row):
    """Write the folder of a run in scene `a` that has ended, from the waypoints of its trials."""

    def saved(path, reached, **facts):
        suite = new_suite(
            {
                "nw-eval": 1, "name": "hurdles", "robot": "go1", "policy": "go1-parkour",
                "trials": len(reached), "seed": 7, "scenes": ("a",), "gate": {"success_rate": 0.5},
            }
        )  # fmt: skip
        run = make_run(
            {"a": len(reached)},
            id=path.name,
            suite=suite.model_dump(by_alias=True, mode="json"),
            suite_digest=suite.digest,
            **facts,
        )
        trials = saved_trials(run, saved_suite(run))
        rows = [
            make_row("a", index, count, trial_id=trial.id, seed=trial.seed, mcap_path="")
            for index, (count, trial) in enumerate(zip(reached, trials, strict=True))
        ]
        return save(path, run, rows).path

    return saved
