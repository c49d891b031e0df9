"""The compiled half of training.

jit.py           how these kernels are compiled and kept
project.py       Gaussians to the renderer's records
project_back.py  gradient of records with respect to Gaussians
blend.py         the records that touch one window, and the gradient of their blend
ssim.py          structural similarity and its gradient
rows.py          the optimiser's step, nearest neighbours, and the noise that explores
"""
