"""The compiled half of the renderer, from the vector type up.

jit.py        how kernels are compiled
kept.py       their machine code in the user's cache, private and checked
simd.py       Float8 and Floats16: float32 lanes, their operators and masks
memory.py     loads and stores of lanes and of single elements
shapes.py     sixteen pixels of the framebuffer: 4x4, 8x2, 16x1
bits.py       bit patterns of floats; the clock of the stages
records.py    one cache line for each splat on the screen
math8.py      exp2, log2 and the pixel-set arithmetic on lanes
view.py       one camera and one window as a flat float32 vector
cull.py       chunks that the window can see, and those that are hidden
harmonics.py  colour of sixteen Gaussians along their view directions
project.py    Gaussians of a chunk to screen-space records
sort.py       radix sort of records by depth
blend.py      front-to-back compositing into a small framebuffer
draw.py       the frame: slabs of depth through the rooms above
"""
