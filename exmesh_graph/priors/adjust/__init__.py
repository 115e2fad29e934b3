"""Cameras adjusted until photographs agree pixel by pixel: photometric bundle adjustment."""
