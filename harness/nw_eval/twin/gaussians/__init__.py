"""Gaussians from photographs whose cameras are known.

    from nw_eval.twin.gaussians.config import TrainConfig
    from nw_eval.twin.gaussians.initial import gaussians_at
    from nw_eval.twin.gaussians.trainer import Trainer

    start = gaussians_at(points, colours, sh_degree=1)
    trainer = Trainer(photos, start, TrainConfig.short(3000), threads=2)
    trainer.run()
    write_splat(path, trainer.gaussians)

photo.py       a photograph, its camera, and what is known of its depth
initial.py     Gaussians at points, such as those of a mesh
config.py      what a training is asked to do
trainer.py     the loop; objective.py, loss.py and exposure.py what it minimises
population.py  Gaussians with their moments; densify/ how they come and go
checkpoint.py  a training on disk
evaluate.py    PSNR and SSIM of views that no step saw
raster/        pictures and gradients; kernels/ its compiled half
"""
