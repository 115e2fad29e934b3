"""`exmesh studio` in a process of its own, and headless Chromium on its page; tests skip where there is none."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

OPTIONS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
PATIENCE = int(os.environ.get("STUDIO_PATIENCE", "120000"))  # milliseconds; the machine may be busy


class Studio:
    """The server's process; `address` is what it printed."""

    def __init__(self, graph: Path, port: int = 0, *words: str, home: Path | None = None) -> None:
        home = home or graph.parent
        command = [sys.executable, "-c", "from exmesh_graph.cli import main; main()", "studio", str(graph),
                   "--no-browser", "--port", str(port), "--store", str(home / ".exmesh"),
                   "--runs", str(home / "runs"), *words]  # fmt: skip
        self.process = subprocess.Popen(command, cwd=home, text=True, stdout=subprocess.PIPE,
                                        stderr=subprocess.STDOUT)  # fmt: skip
        self.said: list[str] = []
        self._heard = threading.Event()
        threading.Thread(target=self._listen, daemon=True).start()
        assert self._heard.wait(PATIENCE / 1000), f"the studio printed no address: {self.said}"
        self.address = re.findall(r"http://\S+", "".join(self.said))[0]

    def _listen(self) -> None:
        assert self.process.stdout
        for line in self.process.stdout:
            self.said.append(line)
            if "http://" in line:
                self._heard.set()

    def kill(self) -> None:
        """As `kill -9`: nothing is said goodbye to."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def end(self) -> None:
        self.process.terminate()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.kill()


@contextmanager
def browser_page(
    width: int = 1280,
    height: int = 720,
    scheme: str = "light",
    motion: str = "reduce",
    options: tuple[str, ...] = OPTIONS,
) -> Iterator[Any]:
    """A page of a fresh browser; `page.faults` collects errors of scripts and answers of 500 and more."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright: the extra `browser`")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs chromium on the PATH")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(options))
        page = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme=scheme, reduced_motion=motion
        ).new_page()
        page.set_default_timeout(PATIENCE)
        page.faults = []
        page.on("pageerror", lambda error: page.faults.append(str(error)))
        page.on("response", lambda r: page.faults.append(f"{r.status} {r.url}") if r.status >= 500 else None)
        try:
            yield page
        except BaseException:
            if folder := os.environ.get("STUDIO_PICTURES"):
                page.screenshot(path=str(Path(folder) / "failed.png"))
            raise
        finally:
            browser.close()


def place(page: Any, selector: str) -> tuple[float, float]:
    """The middle of an element once it has stopped moving."""
    last, deadline = None, time.monotonic() + 30
    while time.monotonic() < deadline:
        box = page.locator(selector).first.bounding_box()
        if box and box == last:
            return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        last = box
        page.wait_for_timeout(200)
    raise AssertionError(f"{selector} does not come to rest")


def reveal(page: Any, node: str) -> None:
    """Moves the graph until a node is in view; nodes out of view are not drawn."""
    page.evaluate("name => window.dispatchEvent(new CustomEvent('studio:reveal', { detail: name }))", node)
    page.wait_for_selector(f'[data-node="{node}"]')
    place(page, f'[data-node="{node}"]')


def select(page: Any, node: str, tab: str = "") -> None:
    """A node, and a tab of its inspector."""
    reveal(page, node)
    page.mouse.click(*place(page, f'[data-node="{node}"] .box-name'))
    page.wait_for_selector(f'.inspector h2:has-text("{node.split(".")[-1]}")')
    if tab:
        page.click(f'.inspector [role=tab]:has-text("{tab}")')


def draw_wire(page: Any, source: str, target: str, drop: bool = True) -> None:
    """From one end to another, each `node handle`."""
    ends = ['[data-node="{}"] [data-handleid="{}"]'.format(*end.split(" ")) for end in (source, target)]
    (x0, y0), (x1, y1) = (place(page, end) for end in ends)
    page.mouse.move(x0, y0)
    page.mouse.down()
    page.mouse.move(x0 + 12, y0 + 6, steps=4)
    page.wait_for_selector(".handle.fits", state="attached")
    page.mouse.move(x1, y1, steps=8)
    page.wait_for_timeout(200)
    if drop:
        page.mouse.up()
