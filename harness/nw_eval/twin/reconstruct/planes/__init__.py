"""What is flat and plain: planes of the place, and which of them each pixel shows.

What has no texture has no depth of its own, but floors, platforms and walls end at edges that have.
Planes are found where depth is known; each pixel is given the one that fits it and its neighbours
best (Sinha, Steedly and Szeliski, "Piecewise planar stereo for image-based rendering", 2009; and
Gallup, Frahm and Pollefeys, "Piecewise planar and non-planar stereo for urban scene
reconstruction", 2010).
"""
