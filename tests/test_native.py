"""Missing libraries are named with the package that holds them."""

import importlib
import subprocess
import sys

import pytest

from exmesh_graph import native
from exmesh_graph.errors import MissingLibraryError


@pytest.mark.parametrize(
    ("library", "package"),
    [("libGL.so.1", "libgl1"), ("libgomp.so.1", "libgomp1"), ("libX11.so.6", "libx11-6")],
)
def test_loader_message_becomes_an_apt_package(library, package):
    message = f"{library}: cannot open shared object file: No such file or directory"
    error = native.missing_system_library(message, "open3d")
    assert library in error.what
    assert error.fix == f"apt-get install {package}"
    assert error.where == "open3d"


def test_unknown_messages_are_passed_on():
    assert "odd thing" in str(native.missing_system_library("odd thing", "open3d"))
    assert "libnew.so.3" in native.missing_system_library("libnew.so.3: cannot open", "x").fix


def test_failing_imports(monkeypatch):
    def fail(error):
        def load(name):
            raise error

        return load

    monkeypatch.setattr(importlib, "import_module", fail(ModuleNotFoundError("No module named 'pymeshlab'")))
    with pytest.raises(MissingLibraryError, match="pip install pymeshlab"):
        native.import_pymeshlab()
    monkeypatch.setattr(importlib, "import_module", fail(ImportError("libGL.so.1: cannot open shared object file")))
    with pytest.raises(MissingLibraryError, match="apt-get install libgl1"):
        native.import_pymeshlab()
    monkeypatch.setattr(importlib, "import_module", fail(OSError("libX11.so.6: cannot open shared object file")))
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    monkeypatch.setattr(native, "_preload_libusb", lambda: None)
    with pytest.raises(MissingLibraryError, match="apt-get install libx11-6"):
        native.import_open3d()


@pytest.mark.thorough
def test_open3d_loads_with_the_wheel_of_libusb_alone():
    """In a fresh process: the system's libusb plays no part, since the wheel's copy is loaded first."""
    code = (
        "from exmesh_graph.native import import_open3d; o = import_open3d();"
        "maps = open('/proc/self/maps').read(); print(o.__version__, 'libusb_package' in maps)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert out.returncode == 0, out.stderr
    if sys.platform == "linux":
        assert out.stdout.split()[-1] == "True"
