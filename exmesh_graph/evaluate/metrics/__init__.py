"""Figures of images, materials, meshes and depth, on numpy arrays."""
