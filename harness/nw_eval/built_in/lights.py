"""Skies and suns that a scene can name."""

from __future__ import annotations

from nw_eval.built_in.places.parts import Light

LIGHTS: dict[str, Light] = {
    "noon": Light(
        sun=(-0.35, 0.45, 0.85),
        sun_colour=(1.55, 1.48, 1.34),
        zenith=(0.17, 0.31, 0.62),
        horizon=(0.55, 0.66, 0.80),
        clouds=0.30,
        exposure=1.0,
    ),
    "afternoon": Light(
        sun=(-0.55, -0.62, 0.58),
        sun_colour=(1.60, 1.38, 1.06),
        zenith=(0.18, 0.30, 0.58),
        horizon=(0.66, 0.68, 0.72),
        clouds=0.42,
        exposure=1.05,
    ),
    "morning": Light(
        sun=(0.30, 0.75, 0.52),
        sun_colour=(1.50, 1.30, 1.02),
        zenith=(0.20, 0.33, 0.62),
        horizon=(0.70, 0.74, 0.80),
        clouds=0.25,
        exposure=0.75,
    ),
    "forenoon": Light(
        sun=(-0.72, 0.17, 0.62),
        sun_colour=(1.58, 1.45, 1.22),
        zenith=(0.17, 0.31, 0.62),
        horizon=(0.58, 0.67, 0.79),
        clouds=0.35,
        exposure=0.78,
    ),
    "overcast": Light(
        sun=(-0.2, 0.3, 0.93),
        sun_colour=(0.12, 0.12, 0.12),
        zenith=(0.82, 0.86, 0.92),
        horizon=(0.62, 0.65, 0.70),
        clouds=1.0,
        exposure=0.8,
        fog=0.10,
    ),
    "dusk": Light(
        sun=(0.80, -0.55, 0.17),
        sun_colour=(0.55, 0.24, 0.10),
        zenith=(0.12, 0.19, 0.44),
        horizon=(0.60, 0.38, 0.32),
        clouds=0.50,
        exposure=0.62,
        fog=0.12,
    ),
    # The sun is the moon; lamps in the place do the rest.
    "night": Light(
        sun=(-0.4, -0.5, 0.75),
        sun_colour=(0.012, 0.015, 0.022),
        zenith=(0.003, 0.005, 0.012),
        horizon=(0.012, 0.011, 0.013),
        clouds=0.10,
        exposure=0.30,
        fog=0.0,
    ),
    # Indoors: the sky and sun are what windows show and let in.
    "indoor": Light(
        sun=(-0.25, 0.85, 0.62),
        sun_colour=(1.9, 1.75, 1.5),
        zenith=(1.3, 1.6, 2.1),
        horizon=(2.0, 2.1, 2.2),
        clouds=0.3,
        exposure=1.0,
        fog=0.0,
    ),
    "indoor_evening": Light(
        sun=(0.30, -0.90, 0.30),
        sun_colour=(1.9, 1.15, 0.6),
        zenith=(0.25, 0.3, 0.5),
        horizon=(0.8, 0.6, 0.5),
        clouds=0.3,
        exposure=1.05,
        fog=0.0,
    ),
    "indoor_night": Light(
        sun=(-0.4, -0.5, 0.75),
        sun_colour=(0.02, 0.02, 0.03),
        zenith=(0.02, 0.03, 0.06),
        horizon=(0.07, 0.06, 0.07),
        clouds=0.15,
        exposure=0.92,
        fog=0.0,
    ),
}
