"""The compiled half of the renderer, above the vectors of `nw_base.simd`.

math8.py      exp2, log2, bit patterns and the pixel-set arithmetic; the clock of the stages
view.py       places in the flat float32 vector of one camera and one window
cull.py       chunks that the window can see, and those that are hidden
project.py    Gaussians of a chunk to records on the screen, with their colours
blend.py      front-to-back compositing into a small framebuffer: 4x4, 8x2 or 16x1 pixels at a time
draw.py       the frame: slabs of depth, sorted by radix, through the stages above
"""
