"""From a capture's own frame to metres: z up, the floor at z = 0, and no person to say so.

align.py        all of it, and what each source of a scale says; the frame's origin and heading
ahead.py        what will give the scale, said before all else
alignment.py    options, what comes of it, and align.json
gravity.py      which way is up, also by upright edges in pictures, and where the floor is
planes.py       planes in the sparse points, and up by all cues together
up.py           up by all cues together
scale.py        how long a unit is, by all sources together
tags.py         printed tags; their corners, and other points, from pixels
positions.py    where shots were taken, by ARKit or GPS
"""
