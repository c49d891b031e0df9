"""What follows from a state: the place as it lies now, and the ground along the course."""

from __future__ import annotations

from functools import cached_property

from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.twin.label.course.ground import Ground
from nw_eval.twin.label.course.profile import HeightProfile, height_profile
from nw_eval.twin.label.crop import cropped
from nw_eval.twin.label.placement import Placement, mapped
from nw_eval.twin.label.state import LabelState, StartPose


class ShownPlace:
    """A state, and what follows from it once somebody wants it.

    Args:
        opened: the mesh in the frame of its file.
        state: that places and crops it.
        ground: of a state with the same placement and crop, if one was built.

    Attributes:
        state: as above.
    """

    def __init__(
        self, opened: TriangleMesh, state: LabelState, ground: Ground | None = None
    ) -> None:
        self.state = state
        self._opened = opened
        self._profile: HeightProfile | None = None
        if ground is not None:
            self.ground = ground

    @property
    def is_built(self) -> bool:
        """Whether there is a `ground` already; a large one takes a second."""
        return "ground" in self.__dict__

    @property
    def mesh(self) -> TriangleMesh:
        """The place; world, m."""
        return self.ground.mesh

    @cached_property
    def ground(self) -> Ground:
        """The place as rays meet it."""
        mesh = self._opened
        if self.state.placement != Placement():
            vertices = mapped(mesh.vertices, self.state.placement.matrix)
            mesh = TriangleMesh(vertices=vertices, faces=mesh.faces, kinds=mesh.kinds)
        if self.state.crop is not None:
            mesh = cropped(mesh, self.state.crop)
        return Ground(mesh)

    def profile(self, start: StartPose) -> HeightProfile:
        """Return the heights from the state's start along its trail."""
        if self._profile is None:
            self._profile = height_profile(self.ground, (start.position, *self.state.waypoints))
        return self._profile
