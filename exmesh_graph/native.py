"""Importing the wheels whose shared libraries need something of the operating system.

Open3D links libusb-1.0 (for depth cameras we never use); the `libusb-package` wheel carries a copy, which is loaded
globally before the import. What else is missing is reported with the Debian/Ubuntu package that holds it.
"""

from __future__ import annotations

import ctypes
import importlib
import re
import sys
from pathlib import Path
from types import ModuleType

from exmesh_graph.errors import MissingLibraryError

# Shared library -> Debian/Ubuntu package, for what Open3D's and PyMeshLab's wheels link but do not carry.
APT_PACKAGES = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libOpenGL.so.0": "libopengl0",
    "libEGL.so.1": "libegl1",
    "libGLU.so.1": "libglu1-mesa",
    "libGLX.so.0": "libglx0",
    "libgomp.so.1": "libgomp1",
    "libX11.so.6": "libx11-6",
    "libxcb.so.1": "libxcb1",
    "libXext.so.6": "libxext6",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libglib-2.0.so.0": "libglib2.0-0",
    "libgthread-2.0.so.0": "libglib2.0-0",
    "libdbus-1.so.3": "libdbus-1-3",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libfontconfig.so.1": "libfontconfig1",
    "libfreetype.so.6": "libfreetype6",
    "libstdc++.so.6": "libstdc++6",
    "libtbb.so.12": "libtbb12",
    "libudev.so.1": "libudev1",
}


def import_open3d() -> ModuleType:
    """The `open3d` module. MissingLibraryError if it, or a system library it needs, is not there."""
    if "open3d" in sys.modules:  # not in the key: libraries=
        return sys.modules["open3d"]  # not in the key: libraries=
    _preload_libusb()
    return _import("open3d", "open3d")


def import_pymeshlab() -> ModuleType:
    """The `pymeshlab` module (GPL-3). MissingLibraryError if it, or a system library it needs, is not there."""
    return _import("pymeshlab", "pymeshlab")


def import_depth_anything() -> ModuleType:
    """The module `depth_anything_3.api`. MissingLibraryError if the optional package is not there."""
    return _import("depth_anything_3.api", "depth-anything-3", fix="pip install 'exmesh-graph[depth]'")


def import_pycolmap() -> ModuleType:
    """The `pycolmap` module (BSD). MissingLibraryError if the optional package is not there.

    OpenImageIO first: loaded after pycolmap, it takes that wheel's zlib for its own, and writing a PNG aborts.
    """
    _import("OpenImageIO", "OpenImageIO")
    return _import("pycolmap", "pycolmap", fix="pip install 'exmesh-graph[photos]'")


def import_pillow_heif(file: Path) -> ModuleType:
    """The `pillow_heif` module, which `file` needs. MissingLibraryError if the optional package is not there."""
    return _import("pillow_heif", "pillow-heif", fix="pip install 'exmesh-graph[heif]'", where=str(file))


def import_rawpy(file: Path) -> ModuleType:
    """The `rawpy` module, which `file` needs. MissingLibraryError if the optional package is not there."""
    return _import("rawpy", "rawpy", fix="pip install 'exmesh-graph[raw]'", where=str(file))


def import_av(file: Path) -> ModuleType:
    """The `av` module (PyAV), which `file` needs. MissingLibraryError if the optional package is not there."""
    return _import("av", "av", fix="pip install 'exmesh-graph[video]'", where=str(file))


def _preload_libusb() -> None:
    try:
        package = importlib.import_module("libusb_package")
        path = package.get_library_path()
    except ImportError:
        return  # the system may have its own; if not, the import below names what is missing
    if path is not None:
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)  # not in the key: a package's own, which its version tells


def _import(module: str, distribution: str, fix: str = "", where: str = "") -> ModuleType:
    try:
        return importlib.import_module(module)  # not in the key: libraries=
    except ModuleNotFoundError as error:
        raise MissingLibraryError(
            f"the Python package {distribution} is not installed ({error})", where=where,
            fix=fix or f"pip install {distribution}",
        ) from error  # fmt: skip
    except (ImportError, OSError) as error:
        raise missing_system_library(str(error), module) from error


def missing_system_library(message: str, module: str) -> MissingLibraryError:
    """Turn the loader's message ("libX.so.1: cannot open shared object file ...") into an error with the fix."""
    match = re.search(r"(lib[\w+.-]+\.so[.\d]*)", message)
    library = match.group(1) if match else ""
    package = APT_PACKAGES.get(library, "")
    if not library:
        return MissingLibraryError(f"{module} cannot be loaded: {message}", where=module)
    fix = f"apt-get install {package}" if package else f"install the system package that holds {library}"
    return MissingLibraryError(
        f"{module} needs the system library {library}, which is not installed", where=module, fix=fix
    )
