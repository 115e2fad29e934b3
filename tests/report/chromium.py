"""A page as headless Chromium shows it."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from exmesh_graph.io.images import read_image


def screenshot(page: Path, width: int, height: int) -> np.ndarray:
    """The first `height` rows of the page, [height, width, 3]; skips the test where there is no Chromium."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs chromium on the PATH")
    shot = page.with_suffix(".png")
    options = (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--host-resolver-rules=MAP * ~NOTFOUND",
    )
    command = [chromium, *options, f"--user-data-dir={page.parent / 'profile'}", f"--window-size={width},{height}",
               f"--screenshot={shot}", page.as_uri()]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return read_image(shot)[..., :3]
