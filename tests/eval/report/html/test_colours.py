"""Outcomes are told apart by those who see fewer colours, too.

Simulated by the matrices of Machado, Oliveira and Fernandes (2009, table 1, severity 1.0) in linear
RGB; differences are CIEDE2000 (Sharma, Wu and Dalal 2005, whose first test pairs are checked).
"""

import re
from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest

SIGHTS = {
    "all colours": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                   [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                     [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                   [0.004733, 0.691367, 0.303900]],
}  # fmt: skip
OUTCOMES = ("completed", "fell", "collided", "stuck", "off_course", "timeout", "policy_failed")
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
     [0.0193339, 0.1191920, 0.9503041]]
)  # fmt: skip


def linear(word):
    word = "".join(2 * each for each in word) if len(word) == 3 else word
    values = np.array([int(word[at : at + 2], 16) for at in (0, 2, 4)]) / 255
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def lab(colour):
    ratio = TO_XYZ @ colour / (0.95047, 1.0, 1.08883)
    f = np.where(ratio > 216 / 24389, np.cbrt(ratio), (24389 / 27 * ratio + 16) / 116)
    return 116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])


def difference(one, two):
    """Return CIEDE2000 between two colours in CIELAB."""
    (l1, a1, b1), (l2, a2, b2) = one, two
    mean = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    g = 0.5 * (1 - np.sqrt(mean**7 / (mean**7 + 25.0**7)))
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    turn = (h2 - h1 + 180) % 360 - 180 if c1 * c2 else 0.0
    hue = (h1 + h2) / 2 if abs(h1 - h2) <= 180 else (h1 + h2 + 360) / 2 % 360
    light, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    t = (
        1 - 0.17 * np.cos(np.radians(hue - 30)) + 0.24 * np.cos(np.radians(2 * hue))
        + 0.32 * np.cos(np.radians(3 * hue + 6)) - 0.2 * np.cos(np.radians(4 * hue - 63))
    )  # fmt: skip
    dl = (l2 - l1) / (1 + 0.015 * (light - 50) ** 2 / np.sqrt(20 + (light - 50) ** 2))
    dc = (c2 - c1) / (1 + 0.045 * chroma)
    dh = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2)) / (1 + 0.015 * chroma * t)
    turned = np.sin(np.radians(60 * np.exp(-(((hue - 275) / 25) ** 2))))
    return np.sqrt(
        dl**2 + dc**2 + dh**2
        - 2 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7)) * turned * dc * dh
    )  # fmt: skip


@pytest.mark.parametrize(
    ("one", "two", "known"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ],
)
def test_the_difference_is_that_of_the_published_pairs(one, two, known):
    assert difference(one, two) == pytest.approx(known, abs=1e-4)


def palettes():
    style = files("nw_eval.reporting").joinpath("templates/page.css").read_text(encoding="utf-8")
    light, dark = re.findall(r":root \{(.*?)\}", style, flags=re.DOTALL)[:2]
    found = []
    for text in (light, dark):
        known = dict(re.findall(r"--([\w-]+): #([0-9a-f]+)", text))
        found.append(({name: known[f"o-{name}"] for name in OUTCOMES}, known["card"]))
    return found


@pytest.mark.parametrize("sight", SIGHTS)
@pytest.mark.parametrize("scheme", [0, 1])
def test_no_two_outcomes_look_alike(scheme, sight):
    """10 is seen at a glance; before this test fell and stuck differed by 1.2."""
    colours, _ = palettes()[scheme]
    seen = {
        name: lab(np.clip(np.asarray(SIGHTS[sight]) @ linear(word), 0.0, 1.0))
        for name, word in colours.items()
    }
    near = {(one, two): difference(seen[one], seen[two]) for one, two in combinations(OUTCOMES, 2)}
    assert min(near.values()) > 15.0, min(near, key=near.__getitem__)


@pytest.mark.parametrize("scheme", [0, 1])
def test_every_outcome_stands_out_from_the_page(scheme):
    """WCAG 2.2, 1.4.11: graphics have a contrast of 3 to 1."""
    colours, card = palettes()[scheme]
    for name, word in colours.items():
        pair = sorted(float(TO_XYZ[1] @ linear(each)) for each in (word, card))
        assert (pair[1] + 0.05) / (pair[0] + 0.05) >= 3.0, name
