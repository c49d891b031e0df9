"""The builder that places are composed with."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from nw_places.places.parts import Crown, Decal, Lamp, Lawn, Light, Pair, Patch, Place
from nw_scenes.mesh import FaceKind
from nw_scenes.scene import Box, Vector

# The faces of a box by the direction they look to, on its own axes.
ALL_FACES = ("-x", "+x", "-y", "+y", "-z", "+z")
SIDES = ("-x", "+x", "-y", "+y")
SIDES_AND_TOP = (*SIDES, "+z")


class SceneBuilder:
    """Collects the parts of one scene; `place()` hands them out as frozen data.

    Lengths are metres in the world: x along the course, y to the left, z up, the spawn at 0, 0, 0.
    """

    def __init__(self, name: str, light: Light, *, indoor: bool, eyes: Iterable[Vector]) -> None:
        self.name = name
        self.light = light
        self.indoor = indoor
        self.eyes = tuple(eyes)
        self._ground = "concrete"
        self._solids: list[Box] = []
        self._patches: list[Patch] = []
        self._crowns: list[Crown] = []
        self._lawns: list[Lawn] = []
        self._lamps: list[Lamp] = []

    def place(self) -> Place:
        """Return what was collected."""
        return Place(
            name=self.name,
            indoor=self.indoor,
            light=self.light,
            ground=self._ground,
            solids=tuple(self._solids),
            patches=tuple(self._patches),
            crowns=tuple(self._crowns),
            lawns=tuple(self._lawns),
            lamps=tuple(self._lamps),
            eyes=self.eyes,
        )

    def ground(
        self,
        material: str,
        x: Pair,
        y: Pair,
        *,
        decals: Iterable[Decal] = (),
        fine: float = 1.0,
    ) -> None:
        """Paint the ground within a rectangle; rays meet the endless plane beneath it.

        Decals are given in world coordinates: x0, y0, x1, y1.
        """
        self._ground = material
        self.quad(
            (x[0], y[0], 0.0),
            (x[1] - x[0], 0.0, 0.0),
            (0.0, y[1] - y[0], 0.0),
            material,
            kind=None,
            fine=fine,
            texture=(x[0], y[0]),
            decals=tuple(
                Decal(
                    (
                        decal.rect[0] - x[0],
                        decal.rect[1] - y[0],
                        decal.rect[2] - x[0],
                        decal.rect[3] - y[0],
                    ),
                    decal.material,
                    decal.fine,
                )
                for decal in decals
            ),
        )

    def quad(
        self,
        origin: Vector,
        u: Vector,
        v: Vector,
        material: str,
        *,
        kind: FaceKind | None = "structure",
        painted: bool = True,
        fine: float = 1.0,
        texture: Pair = (0.0, 0.0),
        decals: Iterable[Decal] = (),
    ) -> None:
        """Add one parallelogram that is seen from the side `u` x `v` points to."""
        self._patches.append(
            Patch(
                origin=_floats(origin),
                u=_floats(u),
                v=_floats(v),
                material=material,
                kind=kind,
                painted=painted,
                fine=float(fine),
                texture=(float(texture[0]), float(texture[1])),
                decals=tuple(decals),
            )
        )

    def box(
        self,
        x: Pair,
        y: Pair,
        z: Pair,
        material: str,
        *,
        top: str | None = None,
        yaw: float = 0.0,
        pitch: float = 0.0,
        roll: float = 0.0,
        solid: bool = True,
        kind: FaceKind = "clutter",
        faces: Iterable[str] = SIDES_AND_TOP,
        fine: float = 1.0,
        decals: Mapping[str, Iterable[Decal]] | None = None,
        texture: Pair = (0.0, 0.0),
    ) -> None:
        """Add a box between two corners, turned about its own middle.

        It is rolled about x, then pitched about y, then yawed about z, in radians; a positive
        pitch lowers the +x end, a positive roll lifts the +y side.

        Args:
            x: from and to.
            y: from and to.
            z: from and to.
            material: of all its faces.
            top: the material of its top, where that differs.
            solid: whether physics touches it; rays meet it either way.
            yaw: radians about the vertical.
            pitch: radians about the y axis.
            roll: radians about the x axis.
            kind: what rays take it for.
            fine: multiplies the spacing of its Gaussians.
            faces: the faces that somebody can see, and that are painted.
            decals: by face name.
            texture: added to the texture coordinates, so that equal boxes differ.
        """
        center = tuple((low + high) / 2 for low, high in (x, y, z))
        half = tuple((high - low) / 2 for low, high in (x, y, z))
        cosine, sine = math.cos(yaw), math.sin(yaw)
        painted = set(faces)

        def leant(px: float, py: float, pz: float) -> Vector:
            if roll != 0.0:
                py, pz = (
                    math.cos(roll) * py - math.sin(roll) * pz,
                    math.sin(roll) * py + math.cos(roll) * pz,
                )
            if pitch != 0.0:
                px, pz = (
                    math.cos(pitch) * px + math.sin(pitch) * pz,
                    math.cos(pitch) * pz - math.sin(pitch) * px,
                )
            return (px, py, pz)

        def world(px: float, py: float, pz: float) -> Vector:
            px, py, pz = leant(px, py, pz)
            return (
                center[0] + cosine * px - sine * py,
                center[1] + sine * px + cosine * py,
                center[2] + pz,
            )

        def edge(px: float, py: float, pz: float) -> Vector:
            px, py, pz = leant(px, py, pz)
            return (cosine * px - sine * py, sine * px + cosine * py, pz)

        hx, hy, hz = half
        # Origin, edges and the scene on the unrolled box, for textures that run round corners.
        frames = {
            "-y": ((-hx, -hy, -hz), (2 * hx, 0, 0), (0, 0, 2 * hz), 0.0),
            "+x": ((hx, -hy, -hz), (0, 2 * hy, 0), (0, 0, 2 * hz), 2 * hx),
            "+y": ((hx, hy, -hz), (-2 * hx, 0, 0), (0, 0, 2 * hz), 2 * hx + 2 * hy),
            "-x": ((-hx, hy, -hz), (0, -2 * hy, 0), (0, 0, 2 * hz), 4 * hx + 2 * hy),
            "+z": ((-hx, -hy, hz), (2 * hx, 0, 0), (0, 2 * hy, 0), 0.0),
            "-z": ((-hx, hy, -hz), (2 * hx, 0, 0), (0, -2 * hy, 0), 0.0),
        }
        for name in ALL_FACES:
            corner, u, v, along = frames[name]
            self.quad(
                world(*corner),
                edge(*u),
                edge(*v),
                top if top is not None and name == "+z" else material,
                kind=kind,
                painted=name in painted,
                fine=fine,
                texture=(texture[0] + along, texture[1] + (z[0] if name[1] != "z" else 0.0)),
                decals=() if decals is None else decals.get(name, ()),
            )
        if solid:
            self._solids.append(
                Box(
                    center=_floats(center),
                    half_size=_floats(half),
                    quat=_quat(yaw, pitch, roll),
                    material=material,
                    kind=kind,
                )
            )

    def prism(
        self,
        center: Pair,
        z: Pair,
        radius: Pair,
        material: str,
        *,
        sides: int = 8,
        kind: FaceKind | None = "clutter",
        fine: float = 1.0,
        lean: Pair = (0.0, 0.0),
        cap: str | None = None,
    ) -> None:
        """Add the mantle of a trunk, pole or drum that nothing touches: radius below and above.

        `lean` moves its upper end by metres in x and y; `cap` closes its top with a material.
        """

        def ring(level: int, corner: int) -> Vector:
            angle = 2 * math.pi * corner / sides
            return (
                center[0] + lean[0] * level + radius[level] * math.cos(angle),
                center[1] + lean[1] * level + radius[level] * math.sin(angle),
                z[level],
            )

        around = 2 * math.pi * radius[0] / sides
        for side in range(sides):
            low, low2 = ring(0, side), ring(0, side + 1)
            high, high2 = ring(1, side), ring(1, side + 1)
            # A parallelogram between the middles of the trapezium's slanting sides.
            foot = _mix(low, low2, 0.5)
            head = _mix(high, high2, 0.5)
            along = _mix(_minus(low2, low), _minus(high2, high), 0.5)
            origin = _minus(foot, tuple(0.5 * part for part in along))
            self.quad(
                origin,
                _floats(along),
                _minus(head, foot),
                material,
                kind=kind,
                fine=fine,
                texture=(around * side, z[0]),
            )
        if cap is not None:
            reach = radius[1] * math.sqrt(math.pi) / 2
            self.quad(
                (center[0] + lean[0] - reach, center[1] + lean[1] - reach, z[1]),
                (2 * reach, 0.0, 0.0),
                (0.0, 2 * reach, 0.0),
                cap,
                kind=kind,
                fine=fine,
            )

    def crown(
        self,
        center: Vector,
        radii: Vector,
        material: str,
        *,
        kind: FaceKind = "overhead",
        fine: float = 1.0,
    ) -> None:
        """Add a cloud of leaves within an ellipsoid."""
        self._crowns.append(
            Crown(
                center=_floats(center),
                radii=_floats(radii),
                material=material,
                kind=kind,
                fine=float(fine),
            )
        )

    def lawn(self, x: Pair, y: Pair, material: str, *, height: float = 0.045) -> None:
        """Let blades of grass stand on the ground within a rectangle."""
        self._lawns.append(
            Lawn(
                rect=(float(x[0]), float(y[0]), float(x[1]), float(y[1])),
                material=material,
                height=float(height),
            )
        )

    def lamp(self, origin: Vector, u: Vector, v: Vector, radiance: Vector) -> None:
        """Let a parallelogram shine to the side `u` x `v` points to; paint it separately."""
        self._lamps.append(
            Lamp(origin=_floats(origin), u=_floats(u), v=_floats(v), radiance=_floats(radiance))
        )


def about(middle: float, half: float) -> Pair:
    """Return from where to where something reaches that is as long to both sides of its middle."""
    return (middle - half, middle + half)


def _quat(yaw: float, pitch: float, roll: float) -> tuple[float, float, float, float]:
    """Return w x y z of a roll about x, then a pitch about y, then a yaw about z."""
    cz, sz = math.cos(yaw / 2), math.sin(yaw / 2)
    cy, sy = math.cos(pitch / 2), math.sin(pitch / 2)
    cx, sx = math.cos(roll / 2), math.sin(roll / 2)
    return (
        round(cz * cy * cx + sz * sy * sx, 12),
        round(cz * cy * sx - sz * sy * cx, 12),
        round(cz * sy * cx + sz * cy * sx, 12),
        round(sz * cy * cx - cz * sy * sx, 12),
    )


def _floats(values: Iterable[float]) -> Vector:
    """Return three floats to a nanometre: sines end differently from one C library to the next."""
    x, y, z = values
    return (round(float(x), 9), round(float(y), 9), round(float(z), 9))


def _mix(one: Iterable[float], two: Iterable[float], share: float) -> Vector:
    return _floats(a + (b - a) * share for a, b in zip(one, two, strict=True))


def _minus(one: Iterable[float], two: Iterable[float]) -> Vector:
    return _floats(a - b for a, b in zip(one, two, strict=True))
