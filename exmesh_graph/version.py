"""The version, as records, provenance and `exmesh --version` give it."""

__version__ = "0.1.0"
