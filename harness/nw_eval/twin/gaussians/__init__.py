"""Gaussians from photographs whose cameras are known.

start = gaussians_at(points, colours, sh_degree=1)
trainer = Trainer(photos, start, TrainConfig.short(3000), threads=2)
trainer.run()
write_splat(path, trainer.gaussians)
"""
