"""From photographs, a video or somebody's cameras to a capture.

calibrate.py    all of it: find what lies at a path, take in, compare, map, develop
report.py       progress lines, and the report of the results
photographs.py  photographs and masks found and taken in; video.py, colmap.py,
                exports.py nerfstudio and apps of phones
features.py     features and matches, match_kernels.py their loops; mapping.py cameras and points
                out of them; kept.py what an earlier calibration that was cut off has found
solution.py     where photographs were taken from, and through which lenses
develop.py      pictures without distortion
"""
