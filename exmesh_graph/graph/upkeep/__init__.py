"""Upkeep of a store and of the machine: accept, pin, gc, verify, doctor. Nothing here is needed to run a graph."""
