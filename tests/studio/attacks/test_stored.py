"""What lies in the store and in the graph's folder, from elsewhere: bombs, odd names, links, YAML in values."""

from __future__ import annotations

import hashlib
import json
import pickle
import resource
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from exmesh_graph.graph import sealed
from exmesh_graph.graph.cache.keys import artifact_digest
from exmesh_graph.graph.session import current_session
from exmesh_graph.studio.workspace import Workspace
from exmesh_graph.types import Files

LOOKS = ("", "/picture", "/contact", "/model", "/points", "/cameras", "/table", "/curves", "/environment", "/view")


class Touch:
    """A pickle that runs a command when it is read."""

    def __reduce__(self) -> Any:
        import os

        return os.system, ("touch pwned",)


@pytest.fixture
def little_memory() -> Iterator[None]:
    """What takes gigabytes fails."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (pages + (3 << 30), before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def forged(workspace: Workspace, kind: str, contents: dict[str, bytes]) -> str:
    """An artifact as somebody who can write into a shared store could make it: all its digests agree."""
    table = {name: [len(data), hashlib.sha256(data).hexdigest()] for name, data in contents.items()}
    digest = artifact_digest(kind, table)
    home = workspace.store_folder / "objects" / digest[:2] / digest
    for name, data in contents.items():
        (home / "data" / name).parent.mkdir(parents=True, exist_ok=True)
        (home / "data" / name).write_bytes(data)
    head = {"format": _format(), "type": kind, "digest": digest, "files": table}
    (home / "artifact.json").write_text(sealed.seal_text(head))
    assert workspace.store().sound(digest)
    return digest


def _format() -> Any:
    from exmesh_graph.graph.cache import store

    return store.FORMAT


def safetensors(header: dict[str, Any], data: bytes = b"") -> bytes:
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data


def npy(shape: tuple[int, ...], data: bytes, kind: str = "<f4") -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


BOMBS: dict[str, tuple[str, dict[str, bytes]]] = {
    "a giant shape": ("Mesh", {
        "arrays.safetensors": safetensors({"vertices": {"dtype": "F32", "shape": [10**12, 3], "data_offsets": [0, 12]}},
                                          b"\0" * 12), "meta.json": b"{}"}),
    "an endless header": ("Mesh", {"arrays.safetensors": struct.pack("<Q", 1 << 62) + b"{}", "meta.json": b"{}"}),
    "pictures without end": ("Views", {
        "arrays.safetensors": safetensors({}), "meta.json": b"{}", 
        "images/stack.json": b'{"shape": [100000000000, 8, 8, 3]}'}),
    "a giant picture": ("Views", {
        "arrays.safetensors": safetensors({}), "meta.json": b"{}", "images/stack.json": b'{"shape": [1, 8, 8, 3]}',
        "images/00000.npy": npy((10**7, 10**5, 3), b"\0" * 64)}),
    "a pickle": ("Views", {
        "arrays.safetensors": safetensors({}), "meta.json": b"{}", "images/stack.json": b'{"shape": [1, 8, 8, 3]}',
        "images/00000.npy": npy((1,), pickle.dumps(Touch()), "|O")}),
    "nested JSON": ("Metrics", {"metrics.json": b"[" * 200_000}),
    "a link of text": ("Files", {"main.json": b'{"main": "../../../../etc/passwd"}', "files/a": b"x"}),
}  # fmt: skip


@pytest.mark.thorough
@pytest.mark.reliability(
    "studio: artifacts of a shared store that are bombs, hold pickles or lie about their sizes",
    "a message, no memory taken, nothing run",
)
@pytest.mark.parametrize("bomb", BOMBS)
def test_bombs_in_artifacts(
    client: TestClient, workspace: Workspace, folder: Path, little_memory: None, bomb: str
) -> None:
    kind, contents = BOMBS[bomb]
    digest, began = forged(workspace, kind, contents), time.monotonic()
    for look in LOOKS:
        answer = client.get(f"/api/artifact{look}", params={"digest": digest})
        assert answer.status_code in (200, 404, 410, 422), (look, answer.text)
        assert "root:" not in answer.text
    assert time.monotonic() - began < 20
    assert not list(folder.rglob("pwned"))
    assert not list(Path.cwd().rglob("pwned"))


@pytest.mark.reliability(
    "studio: an artifact whose bytes somebody changed or cut after it was stored", "410, put aside, made anew"
)
def test_changed_artifacts(client: TestClient, workspace: Workspace) -> None:
    for change in (b'{"psnr":98.7}', b'{"ps'):
        digest = forged(workspace, "Metrics", {"metrics.json": b'{"psnr": 9.1}'})
        path = workspace.store().data(digest) / "metrics.json"
        path.write_bytes(change)
        workspace.shelf._values.clear()
        answer = client.get("/api/artifact/figures", params={"digest": digest})
        assert answer.status_code in (404, 410), answer.text
        assert "98.7" not in answer.text  # as no folder of tests is called


@pytest.mark.reliability(
    "studio: files of artifacts that are pages or scripts, with quotes and line breaks in their names",
    "saved, never shown; no header of their own",
)
def test_files_that_are_pages(client: TestClient, workspace: Workspace, tmp_path: Path) -> None:
    root = tmp_path / "made"
    root.mkdir()
    names = ("a.html", "a.svg", 'x"\r\nset-cookie: a=b\r\n.html', "\u202etxt.exe", "a.js")
    for name in names:
        (root / name).write_text("<script>alert(1)</script>")
    store = workspace.store()
    with store.attempt() as attempt:
        digest = store.put(Files(root=root), attempt).digest
    for name in names:
        answer = client.get("/api/artifact/file", params={"digest": digest, "path": name})
        assert answer.status_code == 200
        assert answer.headers["content-type"] == "application/octet-stream"
        assert answer.headers["content-disposition"].startswith("attachment")
        assert "set-cookie" not in answer.headers
        assert client.get("/api/artifact/gallery", params={"digest": digest, "file": name}).status_code == 404
    for name in ("../artifact.json", "../../main.json", "/etc/passwd", "a.html/..", "..\\main.json", "a.html\0"):
        assert client.get("/api/artifact/file", params={"digest": digest, "path": name}).status_code == 404


@pytest.mark.reliability(
    "studio: pictures of light that lie about their size, or are none", "a message, no memory taken"
)
@pytest.mark.parametrize("name", ["huge.hdr", "huge.exr", "text.exr", "empty.hdr"])
def test_lights(client: TestClient, folder: Path, little_memory: None, name: str) -> None:
    huge = struct.pack("<iiii", 0, 0, 10**6, 10**6)
    exr = b"v/1\x01\x02\x00\x00\x00" + b"channels\0chlist\0" + struct.pack("<i", 19)
    exr += b"R\0" + struct.pack("<iiii", 1, 0, 1, 1) + b"\0"
    for word in (b"dataWindow\0", b"displayWindow\0"):
        exr += word + b"box2i\0" + struct.pack("<i", 16) + huge
    exr += (
        b"compression\0compression\0" + struct.pack("<i", 1) + b"\0" + b"lineOrder\0lineOrder\0" + struct.pack("<i", 1)
    )
    exr += b"\0pixelAspectRatio\0float\0" + struct.pack("<if", 4, 1) + b"screenWindowCenter\0v2f\0"
    exr += struct.pack("<iff", 8, 0, 0) + b"screenWindowWidth\0float\0" + struct.pack("<if", 4, 1) + b"\0"
    made = {"huge.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 900000 +X 900000\n" + b"\0" * 64, "huge.exr": exr,
            "text.exr": b"no picture", "empty.hdr": b""}  # fmt: skip
    (folder / "graphs" / name).write_bytes(made[name])
    began = time.monotonic()
    answer = client.get("/api/light", params={"name": name})
    assert answer.status_code == 422, answer.text
    assert time.monotonic() - began < 10


@pytest.mark.thorough
@pytest.mark.reliability(
    "studio: YAML in the values of edits (anchors, tags, merge keys, line breaks), then saved", "texts, as typed"
)
@pytest.mark.parametrize(
    "text",
    ["*a", "&a 1", "!!python/object/apply:os.system ['touch pwned']", "<<", "a: b", "# x", "}, evil: {type: toy.const",
     "a\nnodes: {evil: {type: toy.const}}", "---\n...", "${n}: x", "'\"", "\u2028x: 1", "- 1", 
     "%YAML 1.1", "null", "1e3"],
)  # fmt: skip
def test_yaml_in_values(client: TestClient, folder: Path, text: str) -> None:
    file = folder / "graphs" / "mine.yaml"
    file.write_text("name: mine\nnodes:\n  one: {type: toy.const, value: 1}\n")
    assert client.post("/api/open", json={"file": "mine.yaml"}).status_code == 200
    answer = client.post("/api/edit", json={"ops": [{"set": "one.label", "to": text}]})
    saved = client.post("/api/save", json={"as": "file", "faulty": True}) if answer.status_code == 200 else answer
    if saved.status_code == 200 and not saved.json()["document"]["problems"]:
        checked = current_session().check(file)
        assert list(checked.nodes) == ["one"]
        assert checked.node("one").params.label == text.replace("${n}", "")  # type: ignore[attr-defined]
    else:
        assert saved.status_code in (200, 422), saved.text
    assert not list(folder.rglob("pwned"))


@pytest.mark.reliability(
    "studio: the open graph becomes a link to a file elsewhere, then is read again and saved",
    "409; not read, not written",
)
def test_the_open_file_becomes_a_link(
    client: TestClient, folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    outside = tmp_path_factory.mktemp("other") / "secret.yaml"
    outside.write_text("# secret\nnodes: {secret: {type: toy.const}}\n")
    file = folder / "graphs" / "mine.yaml"
    file.write_text("nodes: {one: {type: toy.const, value: 1}}\n")
    assert client.post("/api/open", json={"file": "mine.yaml"}).status_code == 200
    client.post("/api/edit", json={"ops": [{"set": "one.value", "to": 2}]})
    file.unlink()
    file.symlink_to(outside)
    assert client.post("/api/reload", json={}).status_code == 409
    assert client.get("/api/text").status_code == 409
    assert client.post("/api/save", json={"as": "file"}).status_code == 409
    assert "secret" not in client.get("/api/document").text.replace("secret.yaml", "")
    assert outside.read_text().startswith("# secret")


@pytest.mark.thorough
@pytest.mark.reliability(
    "studio: a graph that extends or holds a file that is no graph (/etc/passwd, keys)", "a fault without its text"
)
@pytest.mark.parametrize("line", ["extends: {}", "nodes: {{a: {{graph: {}}}}}", "extends: [{}]"])
def test_extending_what_is_no_graph(client: TestClient, folder: Path, line: str) -> None:
    secret = folder / "id_rsa"
    secret.write_text("-----BEGIN KEY-----\nc2VjcmV0: [dGV4dA\n-----END KEY-----\n")
    for path in ("/etc/passwd", str(secret), "/proc/self/environ", "/dev/zero", "../id_rsa"):
        (folder / "graphs" / "mine.yaml").write_text(f"{line.format(path)}\n")
        told = client.post("/api/open", json={"file": "mine.yaml", "discard": True})
        assert told.status_code == 200
        assert told.json()["problems"]
        assert not [word for word in ("root:", "dGV4dA", "c2VjcmV0", "PYTHONPATH=") if word in told.text]
