"""Following all runs of a folder from one thread: new run folders, and what is new in those that go on."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.studio.runview import RunView, is_run

PAUSE = 1.0
"""Seconds between two looks at runs that go on."""
_LIST_EVERY = 2.0
SHOWN = 200
"""Run folders that are looked at, the newest."""

Publish = Callable[[str, Mapping[str, Any]], None]


class Watcher:
    """All runs of a folder. `changed` is called when one finished nodes (False), or began or ended (True).

    `besides` is called each time that the folder is listed.
    """

    def __init__(
        self, runs: Path, publish: Publish, changed: Callable[[bool], None], besides: Callable[[], None] = lambda: None
    ) -> None:
        self.runs, self.publish, self.changed, self.besides = runs, publish, changed, besides
        self.views: dict[str, RunView] = {}
        self.lock = threading.RLock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="studio-watcher", daemon=True)
        self._listed = 0.0

    def start(self) -> None:
        self.look()
        self._thread.start()

    def close(self) -> None:
        self._end.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def all(self, last: int = SHOWN) -> list[RunView]:
        """The runs, the newest first."""
        with self.lock:
            return [self.views[name] for name in sorted(self.views, reverse=True)][:last]

    def view(self, name: str) -> RunView | None:
        with self.lock:
            news = name not in self.views and self._list()
            found = self.views.get(name)
        if news:
            self.changed(True)
        return found

    def look(self) -> None:
        """Look at everything once."""
        news = False
        with self.lock:
            now = time.monotonic()
            listed = now - self._listed >= _LIST_EVERY or not self.views
            if listed:
                news = self._list()
                self._listed = now
            views = list(self.views.values())
        if listed:
            self.besides()
        if news:
            self.changed(True)
        for view in views:
            if view.alive or not view.record:
                self._refresh(view)
            elif view.has_new_report():
                self.publish("runs", {"id": view.id})

    def _refresh(self, view: RunView) -> None:
        with self.lock:
            before = view.state
            told = view.refresh()
        for kind, data in told:
            self.publish(kind, data)
        if view.state != before:
            self.publish("runs", {"id": view.id})
        done = any(kind == "node" and data["state"] == "done" for kind, data in told)
        if view.state != before or done:
            self.changed(view.state != before)

    def _list(self) -> bool:
        """Take in new run folders, and let go of those that are gone; whether there are new ones.

        A short run has ended before it is first seen: what it made is news all the same.
        """
        try:
            names = {path.name for path in self.runs.iterdir() if not path.is_symlink() and path.is_dir()}
        except OSError:
            names = set()
        wanted = {name for name in sorted(names, reverse=True)[:SHOWN] if is_run(self.runs / name)}
        new = wanted - self.views.keys()
        for name in new:
            view = RunView(self.runs / name)
            view.refresh()  # its past is no news
            self.views[name] = view
            self.publish("runs", {"id": name})
            if view.alive:
                self.publish("run", view.facts())
        for name in self.views.keys() - wanted:
            del self.views[name]
            self.publish("runs", {"id": name})
        return bool(new)

    def _follow(self) -> None:
        while not self._end.wait(PAUSE):
            try:
                self.look()
            except Exception as error:  # one odd run folder must not end the following of all
                text = f"the runs cannot be followed: {type(error).__name__}: {error}"
                told = {"run": "", "name": "", "id": "", "kind": "warning", "time": time.time(), "text": text}
                self.publish("log", told)
                self._end.wait(5.0)
