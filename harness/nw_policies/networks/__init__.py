"""Networks that are published as plain weights, written from their specifications.

Each is inference only: one thread, batch 1, no gradients, no random numbers. A network is made
without memory and takes the tensors of a state dict as its own; torch runs it, or the transformer
onnxruntime.

    lucidsim            transformer on camera images (LucidSim, Neverwhere)
    parkour_expert      MLP on scandots with estimator and history (extreme-parkour)
    parkour_student     its student on depth images, with a recurrent state
    act                 action chunks from images (ACT)
    onnx_graph          writes ONNX graphs
    exported            graphs of torch.export files

Sources: the published code of LucidSim and Neverwhere; for ACT, arXiv 2304.13705.
"""
