"""Masks of the object for photographs that have none."""
