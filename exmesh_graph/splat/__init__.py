"""Planar Gaussians: a differentiable rasteriser (Warp kernels, one source for CPU and CUDA) and what is fitted with it.

`gaussians.Gaussians` and `render.render` come first. The room itself loads neither torch nor Warp.
"""
