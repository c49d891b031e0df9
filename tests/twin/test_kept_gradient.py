"""Under which name the machine code of training's kernels is kept."""

from pathlib import Path

import nw_splat.kernels as renderer
import nw_twin.gaussians.kernels as training
from nw_base.machine_code import hash_sources
from nw_twin.gaussians.kernels.blend import blend_back


def test_a_change_in_the_renderers_vector_layer_compiles_the_gradient_anew():
    name = blend_back._cache._cache_file._name
    for package in (renderer, training):
        assert hash_sources(Path(package.__path__[0])) in name
