"""The model of the label page: every decision is a new state, and every state can be gone back to.

Whoever works on the page works on this class; it needs no browser.

edited.py        the line of states
place_edits.py   turn, shift, scale, crop, measure
course_edits.py  waypoints, start, task, proposals
labelling.py     what follows for the robot, and the files
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from nw_eval.plural import plural
from nw_eval.twin.label.course.profile import HeightProfile
from nw_eval.twin.label.course.reach import Hint, hints_on
from nw_eval.twin.label.course_edits import CourseEdits, Propose
from nw_eval.twin.label.folder.opening import OpenedPlace, open_place
from nw_eval.twin.label.folder.published import publish_pair
from nw_eval.twin.label.folder.saving import save_label
from nw_eval.twin.label.placement import Placement
from nw_eval.twin.place import Route
from nw_eval.twin.trail import propose_trail


def open_labelling(folder: Path) -> Labelling:
    """Open a scene folder for labelling.

    Raises:
        SceneError: a file of it is missing or wrong.
    """
    return Labelling(open_place(folder))


class Labelling(CourseEdits):
    """The states of one labelling, and what can be done next. For one thread at a time.

    Every change raises UsageError for what cannot be, and then nothing has changed.

    Args:
        place: as opened.
        propose: finds a trail along steps and edges.
    """

    def __init__(self, place: OpenedPlace, *, propose: Propose = propose_trail) -> None:
        super().__init__(place, propose=propose)
        self._saved = self.state

    @property
    def course(self) -> Route:
        """Task, trail and start, as stages of a build pass them on."""
        start = self.start
        return Route(
            task=self.state.task,
            trail=np.array(self.state.waypoints).reshape(-1, 3),
            spawn=start.position,
            yaw=start.yaw,
        )

    def profile(self) -> HeightProfile:
        """Return the height of the ground from the start along the trail."""
        return self._shown.profile(self.start)

    def hints(self) -> tuple[Hint, ...]:
        """Return what the shipped policy can be expected to do on this course."""
        stops = (self.start.position, *self.state.waypoints)
        return hints_on(stops, self.profile())

    @property
    def words(self) -> str:
        """What is decided, in a line for people."""
        state = self.state
        where = ", ".join(f"{part:.2f}" for part in self.start.position)
        return f"{state.task}, {plural(len(state.waypoints), 'waypoint')}, start at {where}"

    @property
    def is_saved(self) -> bool:
        """Whether the files say what is decided now; markers are not saved."""
        return replace(self.state, markers=()) == replace(self._saved, markers=())

    def save(self) -> Path:
        """Write what is decided into the scene folder that was opened.

        What is undone afterwards can be saved again: all states are of the files as opened.

        Returns:
            The folder.

        Raises:
            UsageError: there is no waypoint.
            SceneError: what would be saved cannot be loaded.
            StoreError: it cannot be written.
        """
        self._check_trail()
        state = self.state
        is_still = state.placement == Placement() and state.crop is None
        save_label(
            self.place,
            course=self.course,
            mesh=None if is_still else self.mesh,
            T_world_opened=state.placement.matrix,
        )
        self._saved = state
        return self.place.folder

    def publish(self, folder: Path) -> Path:
        """Write the scene the published way, XML pair, meshes and splat; return its folder.

        Raises:
            UsageError: there is no waypoint.
            SceneError: the splat cannot be read.
            StoreError: it cannot be written.
        """
        self._check_trail()
        return publish_pair(
            folder,
            name=self.place.name,
            course=self.course,
            mesh=self.mesh,
            splat=self.place.splat,
            T_world_splat=self.T_world_splat,
        )
