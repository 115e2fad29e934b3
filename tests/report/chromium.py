"""A page as headless Chromium shows it."""

import shutil
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from exmesh_graph.io.images import read_image

WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
NO_WEBGL = ("--disable-3d-apis",)


def screenshot(page: Path, width: int, height: int, *more: str, state: str = "") -> np.ndarray:
    """The first `height` rows of the page, [height, width, 3]; skips the test where there is no Chromium.

    `more` are further options of the browser; `state` goes behind the address's '#'.
    """
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs chromium on the PATH")
    shot = page.with_suffix(".png")
    options = (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
        *more,
    )
    command = [chromium, *options, f"--user-data-dir={page.parent / 'profile'}", f"--window-size={width},{height}",
               f"--screenshot={shot}", f"{page.as_uri()}#{state}"]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return read_image(shot)[..., :3]


def screenshot_when(page: Path, selector: str, width: int, height: int, *more: str, state: str = "") -> np.ndarray:
    """As `screenshot`, once the page holds an element for the CSS `selector`, which it must within 30 seconds.

    Chromium takes its picture when a page has loaded: a picture from a server in this process keeps it from having.
    """
    ready = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path == "/ready":
                ready.set()
            else:
                ready.wait(30)
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Nothing to the terminal."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}"
    hold = (
        f'<img src="{address}/hold" hidden><script>setInterval(() => {{ if (document.querySelector({selector!r})) '
        f"fetch('{address}/ready', {{mode: 'no-cors'}}); }}, 100);</script></body>"
    )
    held = page.with_name(f"{page.stem}_held.html")
    held.write_text(page.read_text(encoding="utf-8").replace("</body>", hold), encoding="utf-8")
    try:
        pixels = screenshot(held, width, height, *more, state=state)
    finally:
        ready_in_time = ready.is_set()
        ready.set()
        server.shutdown()
    assert ready_in_time, f"the page never held {selector}"
    return pixels
