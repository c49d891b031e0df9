"""The compiled half of training.

jit.py        how these kernels are compiled and kept
lanes.py      sums over lanes, beside the renderer's own vector layer
harmonics.py  real spherical harmonics and their slopes
ellipsoid.py  rotations from quaternions, and back
project.py    Gaussians to the renderer's records
gather.py     the records that touch one window
blend_back.py gradient of the blend with respect to records
project_back.py gradient of records with respect to Gaussians
ssim.py       structural similarity and its gradient
adam.py       one step of the optimiser
nearby.py     distances to nearest neighbours
perturb.py    the noise that explores
"""
