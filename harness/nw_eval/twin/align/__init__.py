"""From a capture's own frame to metres: z up, the floor at z = 0, and no person to say so.

align.py        all of it, and where the metric frame's origin and heading are
ahead.py        what will give the scale, said before all else
alignment.py    options, what comes of it, and align.json
gravity.py      which way is up, and where the floor is
consensus.py    up by all cues together; edges.py by upright edges in pictures
planes.py       planes in the sparse points
scale.py        how long a unit is, by every cue
tags.py         printed tags; triangulate.py their corners, and other points, from pixels
positions.py    where shots were taken, by ARKit or GPS
"""
