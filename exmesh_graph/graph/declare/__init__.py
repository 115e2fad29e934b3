"""Declaring nodes, ports, components and packs of them."""
