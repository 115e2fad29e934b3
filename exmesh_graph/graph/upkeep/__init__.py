"""Upkeep of a store: pin, gc, verify. Nothing here is needed to run a graph."""
