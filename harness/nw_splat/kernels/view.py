"""One camera, one pixel set and one window of it as the flat float32 vector that kernels read."""

R, T = 0, 9
FX, FY, CX, CY = 12, 13, 14, 15
X_LOW, X_HIGH, Y_LOW, Y_HIGH = 16, 17, 18, 19  # bounds of x/z and y/z in the Jacobian
NEAR, FAR = 20, 21
STRIDE, INVERSE_STRIDE, OFFSET, BLOCK = 22, 23, 24, 25
COLUMN0, COLUMN1, ROW0, ROW1 = 26, 27, 28, 29  # window, in taken pixels, end exclusive
LEFT, RIGHT, TOP, BOTTOM = 30, 31, 32, 33  # window, in pixels of the full image
EYE = 34  # camera centre in the world
SPREAD_X, SPREAD_Y = 37, 38  # most pixels that a unit length at depth 1 spans
SIZE = 40
