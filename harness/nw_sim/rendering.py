"""How the pictures that a policy sees are drawn, as a suite says it."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from nw_base.words import Projection


class Rendering(BaseModel):
    """How Gaussians become the pictures that a policy sees; the defaults are the published ones.

    Its fields are options of `nw_splat.open_renderer`. Which machine part computes it is no
    matter of the suite: `--render`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    projection: Projection = Field(
        "ewa",
        description="ewa: as gsplat and the published evaluation draw, with perspective replaced "
        "by its tangent at each Gaussian's centre. ray: each Gaussian along the pixel's own ray, "
        "right for wide cameras near the ground.",
    )
    samples: Literal[1, 4] = Field(
        1,
        description="Of a pixel: 1 with gsplat's low-pass, or the mean of 2x2 with hardly any.",
    )
    near: float = Field(
        0.01,
        gt=0.0,
        le=10.0,
        description="Least depth of a Gaussian's centre before the camera, m.",
    )


PUBLISHED = Rendering()  # pyright: ignore[reportCallIssue]  # Defaults sit in Field.
"""How pictures are drawn where nothing is said."""

SHOWN = PUBLISHED.model_copy(update={"projection": "ray"})
"""How pictures for people are drawn, which are large, or are averaged themselves."""

DRAFTED = SHOWN.model_copy(update={"samples": 4})
"""How the pictures of suites that nw-eval writes are drawn."""
