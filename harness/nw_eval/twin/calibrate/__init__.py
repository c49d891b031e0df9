"""From photographs, a video or somebody's cameras to a capture.

calibrate.py    all of it: find, take in, compare, map, develop
options.py      what is asked; report.py what was found
sources.py      what lies at a path: footage.py photographs and masks, video.py, colmap.py,
                exports.py nerfstudio and apps of phones
photographs.py  photographs taken in
features.py     features and matches, match_kernels.py their loops; mapping.py cameras and points
                out of them; kept.py what an earlier calibration that was cut off has found
solution.py     where photographs were taken from, and through which lenses
develop.py      pictures without distortion
pace.py         how far a piece of work is; packages.py what it needs
"""
