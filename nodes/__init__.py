"""The built-in node families, imported as `exmesh_nodes`; every module of this folder is one family.

The framework imports the modules one by one (`graph.declare.packs`), so that a broken one takes down only its own
node types. None of them holds numerics, they bind wire types to the library, and none imports a heavy library at the
top, so that `exmesh check` and `exmesh plan` answer at once.
"""
