"""Scanned places as something physics can touch.

`solids` are the kinds of solid beside boxes; `compile_terrain` in `compile` makes them from a
triangle mesh; `attach` puts them into a MuJoCo specification; `mesh_file` reads meshes.

This package imports nothing here, so that `scenes.scene` can name the solids.
"""
