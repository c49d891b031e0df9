"""Gaussians from photographs whose cameras are known.

    from nw_twin.gaussians.config import TrainConfig
    from nw_twin.gaussians.initial import gaussians_at
    from nw_twin.gaussians.trainer import Trainer

    start = gaussians_at(points, colours, sh_degree=1)
    trainer = Trainer(photos, start, TrainConfig.short(3000), threads=2)
    trainer.run()
    write_splat(path, trainer.gaussians)

config.py      options of a training
trainer.py     the loop, and a training on disk
initial.py     Gaussians to begin with: at points, such as those of a mesh, and of the sky
images.py      a photograph, its known depths, and the rendered images
rasteriser.py  pictures and gradients; kernels/ its compiled half
loss.py        what training minimises; PSNR and SSIM of views that no step saw
density.py     Gaussians with their moments, how they come and go; floaters
"""
