"""The built-in node families, imported as `exmesh_nodes`. Importing them registers their node types.

Every module of this folder is one family and holds no numerics: it binds wire types to the library. None of them
imports a heavy library at the top, so that `exmesh check` and `exmesh plan` answer at once.
"""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
