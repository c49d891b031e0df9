"""align.json: an alignment on disk."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from nw_eval.errors import NwEvalError, SceneError
from nw_eval.files.cache import atomic_path
from nw_eval.files.inside import regular
from nw_eval.scenes.neverwhere.scan import check_similarity
from nw_eval.twin.align.alignment import Alignment, GravityCue, ScaleCue

ALIGN_FILE = "align.json"

_MOST_BYTES = 2**20
_FIX = "align again: `nw-eval twin align`"

_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class _AlignModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _GravityEntry(_AlignModel):
    name: str
    up: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    degrees: Annotated[float, Field(ge=0, le=180)]
    uncertain: Annotated[FiniteFloat, Field(ge=0)]
    reason: str


class _ScaleEntry(_AlignModel):
    name: str
    scale: Annotated[FiniteFloat, Field(gt=0)]
    difference: FiniteFloat
    used: bool
    reason: str


class _AlignFile(_AlignModel):
    version: int = Field(alias="nw-align", default=1, ge=1, le=1)
    T_metric_capture: Annotated[tuple[_Row, ...], Field(min_length=4, max_length=4)]
    scale: Annotated[FiniteFloat, Field(gt=0)]
    floor_share: Annotated[float, Field(ge=0, le=1)]
    gravity: tuple[_GravityEntry, ...]
    scales: tuple[_ScaleEntry, ...]
    warnings: tuple[str, ...]


def write_alignment(alignment: Alignment, path: Path) -> None:
    """Write an alignment; the file appears whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    content = {
        "nw-align": 1,
        "T_metric_capture": alignment.T_metric_capture.tolist(),
        "scale": alignment.scale,
        "floor_share": alignment.floor_share,
        "gravity": [vars(cue) for cue in alignment.gravity],
        "scales": [vars(cue) for cue in alignment.scales],
        "warnings": alignment.warnings,
    }
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_alignment(path: Path) -> Alignment:
    """Read an alignment.

    Raises:
        SceneError: there is none, it is damaged, or its matrix is no similarity of its scale.
    """
    try:
        if regular(path).stat().st_size > _MOST_BYTES:
            raise SceneError(f"{path} is larger than {_MOST_BYTES} bytes", fix=_FIX)
        file = _AlignFile.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        raise SceneError(f"there is no {path}", fix=_FIX) from None
    except NwEvalError:
        raise
    except (OSError, ValueError, ValidationError) as error:
        raise SceneError(f"{path} is no alignment: {error}", fix=_FIX) from None
    T = np.array(file.T_metric_capture)
    scale = check_similarity(T, str(path))
    if abs(scale / file.scale - 1.0) > 1e-6 or (T[3] != [0, 0, 0, 1]).any():
        raise SceneError(
            f"{path}: its matrix has the scale {scale:g} and the last row {T[3].tolist()}, "
            f"the file says {file.scale:g}",
            fix=_FIX,
        )
    return Alignment(
        T_metric_capture=T,
        scale=file.scale,
        gravity=tuple(GravityCue(**cue.model_dump()) for cue in file.gravity),
        scales=tuple(ScaleCue(**cue.model_dump()) for cue in file.scales),
        floor_share=file.floor_share,
        warnings=file.warnings,
    )
