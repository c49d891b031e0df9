"""How long a unit of the capture is.

triangulate.py   points from pixels in several shots
tags.py          printed tags of known edge
lengths.py       lengths and heights that somebody measured
positions.py     where shots were taken, by ARKit or GPS
exif.py          where photographs say that they were taken
answer.py        all of it, in the order of trust
"""
