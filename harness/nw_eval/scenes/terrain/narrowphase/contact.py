"""A contact as a row of numbers: written, thinned out, and handed to MuJoCo."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import kernel

CONTACT = 7
"""Numbers of a contact: distance (negative: how deep), x, y, z of the surface, outward normal."""


@kernel
def write_contact(
    contact: Any, depth: Any, x: Any, y: Any, z: Any, nx: Any, ny: Any, nz: Any
) -> None:
    """Write one contact, (CONTACT,)."""
    contact[0] = depth
    contact[1], contact[2], contact[3] = x, y, z
    contact[4], contact[5], contact[6] = nx, ny, nz


@kernel
def fewest(contacts: Any, most: Any) -> Any:
    """Keep the contacts that carry: the deepest, then always the one farthest from those kept.

    Args:
        contacts: (N, CONTACT) of one shape.
        most: how many to keep.
    """
    if len(contacts) <= most:
        return contacts
    kept = np.empty((most, contacts.shape[1]))
    distance = np.full(len(contacts), math.inf)
    chosen = 0
    for index in range(len(contacts)):
        if contacts[index, 0] < contacts[chosen, 0]:
            chosen = index
    for number in range(most):
        kept[number] = contacts[chosen]
        x, y, z = contacts[chosen, 1], contacts[chosen, 2], contacts[chosen, 3]
        farthest = 0
        for index in range(len(contacts)):
            dx = contacts[index, 1] - x
            dy = contacts[index, 2] - y
            dz = contacts[index, 3] - z
            distance[index] = min(distance[index], dx * dx + dy * dy + dz * dz)
            if distance[index] > distance[farthest]:
                farthest = index
        chosen = farthest
    return kept


@kernel
def write_records(contacts: Any, origin: Any, frame: Any, records: Any) -> Any:
    """Write contacts as MuJoCo's records, in the world; return how many."""
    for index in range(len(contacts)):
        c, record = contacts[index], records[index]
        record[0] = c[0]
        for row in range(3):
            x, y, z = frame[row, 0], frame[row, 1], frame[row, 2]
            normal = x * c[4] + y * c[5] + z * c[6]
            # Midway between the two surfaces.
            place = origin[row] + x * c[1] + y * c[2] + z * c[3]
            record[1 + row] = place + 0.5 * c[0] * normal
            record[4 + row] = normal
            record[7 + row] = 0.0
    return len(contacts)
