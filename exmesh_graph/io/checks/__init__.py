"""Checks of cameras and pictures, run by the loaders: what is found is named with its views, cause and cure."""
