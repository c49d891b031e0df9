"""Sensors and wrappers of other packages: found, checked, and kept from breaking anything."""

import sys
import warnings

import numpy as np
import pytest
from pydantic import ValidationError

from nw_base.errors import PolicyError
from nw_base.plugins import SENSORS, WRAPPERS, PluginWarning, installed, usable
from nw_policies.cards import JointControl, load_card
from nw_policies.cards.wrappers import BUILT_IN_WRAPPERS
from nw_sim.rollout.episode import Actions
from nw_sim.sensors import StepContext, build_sensors, check_card
from nw_sim.tasks import Course

GOOD = """
import numpy as np

class Halve:
    def __init__(self, times=1):
        self.factor = 0.5 ** times
    def __call__(self, sample, shot):
        return (sample * self.factor).astype(np.float32)

class Height:
    shape, dtype, unit = (1,), np.float32, "m"
    def __init__(self, robot, offset=0.0):
        self.offset = offset + robot.spawn_height
    def attach(self, place):
        self.ground = place.world.scene.ground.z
    def measure(self, moment):
        return np.array([moment.position[2] - self.ground + self.offset], dtype=np.float32)

class Raises:
    def __call__(self, sample, shot):
        if shot.moment is None:
            return sample
        raise RuntimeError("the GPU is on fire")

class Shrinks:
    def __call__(self, sample, shot):
        return sample if shot.moment is None else sample[1:]

class Talks:
    def __call__(self, sample, shot):
        return "an image of a dog"

class Counts:
    def __init__(self):
        self.count = 0
    def reset(self, rng):
        self.count = 0
    def __call__(self, sample, shot):
        self.count += 1
        return sample + np.float32(self.count)
    def state(self):
        return {"count": np.array(self.count)}
    def restore(self, state):
        self.count = int(state["count"])

class InPlace:
    # Halves in place, and returns the same array for every sample.
    def __init__(self):
        self.given = None
    def __call__(self, sample, shot):
        sample *= np.float32(0.5)
        if self.given is None:
            self.given = sample.copy()
        self.given[:] = sample
        return self.given

class Clock:
    # Returns the same array for every measurement.
    shape, dtype = (1,), np.float32
    def __init__(self, robot):
        self.given = np.zeros(1, np.float32)
    def measure(self, moment):
        self.given[:] = moment.step
        return self.given

class Meddles(Clock):
    def __init__(self, robot, what):
        super().__init__(robot)
        self.what = what
    def measure(self, moment):
        what, place = self.what, moment.world.scene
        array = {"trail": place.trail, "cones": moment.cones}.get(what)
        array = getattr(moment, what) if array is None else array
        (array[0] if isinstance(array, tuple) else array)[:] = 7.0
        return self.given

class Half:
    def __call__(self, sample, shot):
        return sample
    def state(self):
        return {}

class Old:
    def __call__(self, sample, shot):
        return sample
    def memory(self):
        return {}
    def remember(self, memory):
        pass
"""
ENTRIES = {
    "good": (
        "[nw_eval.wrappers]\nhalve = plugged:Halve\ncrop = plugged:Halve\n"
        "[nw_eval.sensors]\nheight = plugged:Height\n"
    ),
    "broken": "[nw_eval.wrappers]\ngone = no_such_module_anywhere:Diffuse\n",
    "rival": "[nw_eval.wrappers]\nhalve = plugged:Raises\n",
}
DEPTH = {"sensor": "depth", "width": 16, "height": 9}


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """Install three packages: a good one, a broken one, and one that claims a taken name."""
    (tmp_path / "plugged.py").write_text(GOOD)
    for name, entries in ENTRIES.items():
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(entries)
    monkeypatch.syspath_prepend(tmp_path)
    installed.cache_clear()
    yield tmp_path
    installed.cache_clear()
    sys.modules.pop("plugged", None)


def read(world, card, moment, name="o", **options):
    sensor = build_sensors(card, world, **options)[name]
    sensor.reset(0)
    return sensor.read(moment)


@pytest.mark.usefixtures("packages")
def test_an_installed_wrapper_is_named_like_a_built_in_one(world, card_of, moment_of):
    plain, once, thrice = (
        card_of({"o": DEPTH | {"wrap": wrap}})
        for wrap in ([], ["halve"], [{"wrapper": "halve", "times": 3}])
    )
    with pytest.warns(PluginWarning, match="plug-in 'halve' of rival .* is taken by good"):
        once, thrice = (read(world, card, moment_of(world)) for card in (once, thrice))
    depth = read(world, plain, moment_of(world))
    np.testing.assert_allclose(once, depth / 2)
    np.testing.assert_allclose(thrice, depth / 8)


@pytest.mark.usefixtures("packages")
def test_an_installed_sensor_has_rate_noise_and_wrappers(world, card_of, moment_of):
    request = {"sensor": "height", "offset": 1.0, "rate": 10, "wrap": [{"wrapper": "scale"}]}
    card = card_of({"o": request})
    (spec,) = check_card(card)
    assert (spec.shape, spec.rate) == ((1,), 10)
    expected = world.trunk_position[2] + 1.0 + world.robot.spawn_height
    assert read(world, card, moment_of(world)) == pytest.approx([expected], abs=1e-6)


@pytest.mark.usefixtures("packages")
def test_a_broken_plug_in_warns_and_names_itself_and_the_others_work():
    with pytest.warns(PluginWarning) as caught:
        found = usable(WRAPPERS, BUILT_IN_WRAPPERS)
    assert found == {"halve": "good"}
    told = sorted(str(warning.message) for warning in caught)
    assert len(told) == 3
    assert told[0].startswith("plug-in 'crop' of good (plugged:Halve) is ignored: 'crop' is built")
    assert "plug-in 'gone' of broken (no_such_module_anywhere:Diffuse) is broken" in told[1]
    assert "ModuleNotFoundError" in told[1]
    assert "'halve' is taken by good" in told[2]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert usable(SENSORS, ()) == {"height": "good"}


@pytest.mark.usefixtures("packages")
def test_a_card_that_names_a_broken_plug_in_is_told_whose_it_is(card_of):
    with pytest.raises(PolicyError) as caught:
        check_card(card_of({"o": DEPTH | {"wrap": ["gone"]}}))
    text = str(caught.value)
    assert "plug-in 'gone' of broken (no_such_module_anywhere:Diffuse) cannot be opened" in text


@pytest.mark.usefixtures("packages")
def test_a_card_that_names_no_plug_in_imports_none(world, card_of, moment_of):
    sys.modules.pop("plugged", None)
    read(world, card_of({"o": DEPTH}), moment_of(world))
    assert "plugged" not in sys.modules


@pytest.mark.usefixtures("packages")
def test_a_built_in_name_stays_the_built_in_one(world, card_of, moment_of):
    card = card_of({"o": DEPTH | {"wrap": [{"wrapper": "crop", "top": 4}]}})
    assert read(world, card, moment_of(world)).shape == (5, 16)


def test_code_beside_a_card_needs_permission(packages, world, card_of, moment_of):
    sys.modules.pop("plugged", None)
    card = card_of({"o": DEPTH | {"wrap": ["plugged:Halve"]}})
    with pytest.raises(PolicyError, match="'plugged:Halve' imports and runs Python code; add --al"):
        build_sensors(card, world)
    with pytest.raises(PolicyError, match="--allow-code"):
        check_card(card)
    assert "plugged" not in sys.modules
    assert read(world, card, moment_of(world), code_from=packages).shape == (9, 16)
    assert check_card(card, code_from=packages)[0].dtype == np.float32


@pytest.mark.parametrize(
    ("wrapper", "said"),
    [
        ("plugged:Nothing", "plugged:Nothing cannot be opened: AttributeError"),
        ("no_module_of_that_name:X", "cannot be opened: ModuleNotFoundError"),
        ("plugged:Talks", "wrapper plugged:Talks returned a str; return a NumPy array"),
        ("plugged:Half", "has only one of `state` and `restore`"),
        ("plugged:Old", "which are no longer called; call them `state` and `restore`"),
    ],
)
def test_what_is_wrong_with_code_is_said_before_any_physics(packages, card_of, wrapper, said):
    card = card_of({"o": DEPTH | {"wrap": [wrapper]}})
    with pytest.raises(PolicyError) as caught:
        check_card(card, code_from=packages)
    assert said in str(caught.value)


def test_a_parameter_that_a_class_does_not_take_is_named(packages, card_of):
    card = card_of({"o": DEPTH | {"wrap": [{"wrapper": "plugged:Halve", "tims": 2}]}})
    with pytest.raises(
        PolicyError, match=r"unexpected keyword argument 'tims'.*parameters \['tims'\]"
    ):
        check_card(card, code_from=packages)


@pytest.mark.parametrize(
    ("wrapper", "said"),
    [
        ("plugged:Raises", "wrapper plugged:Raises raised RuntimeError .*: the GPU is on fire"),
        ("plugged:Shrinks", r"returned \(8, 16\) float32, on its trial run \(9, 16\) float32"),
    ],
)
def test_a_wrapper_that_fails_in_a_trial_is_named(
    packages, world, card_of, moment_of, wrapper, said
):
    card = card_of({"eye": DEPTH | {"wrap": [wrapper]}})
    with pytest.raises(PolicyError, match="`eye`: .*" + said):
        read(world, card, moment_of(world), "eye", code_from=packages)


def test_the_memory_of_a_wrapper_goes_along_with_the_state(packages, world, card_of, moment_of):
    card = card_of({"o": DEPTH | {"wrap": ["plugged:Counts"]}})
    first, second = (build_sensors(card, world, code_from=packages)["o"] for _ in range(2))
    for sensor in (first, second):
        sensor.reset(0)
    for step in range(5):
        first.read(moment_of(world, step=step))
    second.restore(first.state())
    expected = first.read(moment_of(world, step=5))
    np.testing.assert_array_equal(second.read(moment_of(world, step=5)), expected)
    # Counting begins with the first sample of the trial, not with the trial run.
    fresh = build_sensors(card, world, code_from=packages)["o"]
    fresh.reset(0)
    depth = read(world, card_of({"o": DEPTH}), moment_of(world))
    np.testing.assert_allclose(fresh.read(moment_of(world)), depth + 1.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("observation", "said"),
    [
        ({"sensor": "dpth"}, "'dpth' is not known; did you mean 'depth'?"),
        (DEPTH | {"wrap": ["grayscal"]}, "'grayscal' is not known; did you mean 'grayscale'?"),
        (DEPTH | {"wrap": ["my pkg:X"]}, "'my pkg:X' is not a class; write package.module:Class"),
        (DEPTH | {"wrap": [{"wrapper": "crop", "topp": 1}]}, "Extra inputs"),
        (DEPTH | {"noise": {"dropout": 2}}, "less than or equal to 1"),
    ],
)
def test_misspelt_names_are_refused(card_of, observation, said):
    with pytest.raises(ValidationError) as caught:
        card_of({"o": observation})
    assert said in str(caught.value)


def test_a_misspelt_key_of_a_wrapper_is_told_with_its_line(tmp_path):
    (tmp_path / "policy.yaml").write_text(
        "nw-policy: 1\nname: m\nrobot: go1\nadapter: zero\n"
        "control: {action: joint_position_offset}\n"
        "observations:\n  eye:\n    sensor: depth\n    wrap:\n      - {wrapper: crop, topp: 3}\n"
    )
    with pytest.raises(PolicyError) as caught:
        load_card(tmp_path / "policy.yaml")
    assert ":10:25: unknown key 'topp'; did you mean 'top'?" in str(caught.value)


def test_a_wrapper_that_writes_into_its_sample_and_its_answer_changes_no_other_sample(
    world, card_of, moment_of, tmp_path
):
    (tmp_path / "writing.py").write_text(GOOD)
    halved = {"wrapper": "writing:InPlace"}
    scaled = {"wrapper": "scale", "scale": 0.5}
    stack = {"wrapper": "stack", "steps": 2}
    for before in ([], [stack]):
        card, plain = (
            card_of({"o": DEPTH | {"wrap": [*before, wrap, stack], "latency": 0.02}})
            for wrap in (halved, scaled)
        )
        writing = build_sensors(card, world, code_from=tmp_path)["o"]
        scaling = build_sensors(plain, world)["o"]
        for sensor in (writing, scaling):
            sensor.reset(0)
        pairs = []
        for step in range(4):
            world.step(world.joint_positions + 0.1)
            pairs.append([sensor.read(moment_of(world, step)) for sensor in (writing, scaling)])
        assert not np.array_equal(pairs[0][1], pairs[-1][1])
        for ours, theirs in pairs:
            np.testing.assert_array_equal(ours, theirs)
    sys.modules.pop("writing", None)


def test_a_sensor_that_writes_into_what_it_returned_changes_no_earlier_measurement(
    world, card_of, moment_of, tmp_path
):
    (tmp_path / "ticking.py").write_text(GOOD)
    card = card_of({"o": {"sensor": "ticking:Clock", "latency": 0.04}})
    sensor = build_sensors(card, world, code_from=tmp_path)["o"]
    sensor.reset(0)
    seen = [sensor.read(moment_of(world, step)) for step in range(5)]
    assert [float(sample[0]) for sample in seen] == [0.0, 0.0, 0.0, 1.0, 2.0]
    sys.modules.pop("ticking", None)


@pytest.mark.parametrize("what", ["applied_action", "last_output", "position", "cones", "trail"])
def test_a_sensor_cannot_write_into_what_it_is_shown(what, world, card_of, tmp_path):
    (tmp_path / "meddling.py").write_text(GOOD)
    card = card_of({"o": {"sensor": "meddling:Meddles", "what": what}})
    sensor = build_sensors(card, world, code_from=tmp_path)["o"]
    control = JointControl.from_card(card, world.robot)
    task = Course.along(world.scene.trail)
    actions = Actions(control, world.robot.joints, delay_steps=1, action_filter=None)
    actions.take(np.ones(12))
    moment = StepContext(
        world=world,
        task=task,
        step=1,
        applied_action=actions.applied.array,
        last_output=actions.output.array,
    )
    sensor.reset(0)
    with pytest.raises(PolicyError, match=r"measure raised ValueError: .* read-only"):
        sensor.read(moment)
    sys.modules.pop("meddling", None)
