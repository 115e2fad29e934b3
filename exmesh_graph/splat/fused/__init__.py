"""Planar Gaussians on a CPU in float32: native passes that share the cores, eight Gaussians or pixels at a time.

The Warp kernels beside this folder do the same in float64 and on CUDA, and are what these are tested against.
"""
