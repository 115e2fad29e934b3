"""Upkeep of a store and of the machine: pin, gc, verify, doctor. Nothing here is needed to run a graph."""
