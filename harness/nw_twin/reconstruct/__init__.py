"""From a capture to depth maps with confidence and a mesh.

By default all of it is done here: PatchMatch stereo with slanted windows measures the depth of each
shot, a truncated signed distance joins them, and marching cubes cut its surface. OpenMVS does
the same where its programs are installed and it is chosen.
"""
