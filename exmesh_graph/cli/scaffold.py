"""`exmesh new-node`: a working node with parameters, documentation and a passing test, in a pack that installs."""

from __future__ import annotations

import keyword
import re
from pathlib import Path

from exmesh_graph.errors import GraphError

_TEMPLATES = Path(__file__).with_name("templates")


def write_node(kind: str, folder: Path) -> list[Path]:
    """Write the node type `kind` into the node pack `folder`; returns the new files. Raises GraphError."""
    match = re.fullmatch(r"([a-z][a-z0-9_]*)\.([a-z][a-z0-9_]*)", kind)
    if match is None or keyword.iskeyword(match[2]):
        raise GraphError(
            f"{kind!r} cannot name a node type",
            expected="family.name in small letters, no word of Python: geometry.smooth",
        )
    package, root = folder.resolve().name, folder.resolve().parent
    if not package.isidentifier():
        raise GraphError(f"the folder {package!r} cannot be a Python package", fix="--into my_nodes")
    names = {
        "type": kind, "module": f"{match[1]}_{match[2]}", "function": match[2], "package": package,
        "project": package.replace("_", "-"), "Class": "".join(word.capitalize() for word in match[2].split("_")),
    }  # fmt: skip
    texts = {
        folder / f"{names['module']}.py": "node.txt",
        root / "tests" / f"test_{names['module']}.py": "test.txt",
        folder / "__init__.py": "package.txt",
        root / "pyproject.toml": "pyproject.txt",
    }
    taken = [path for path in list(texts)[:2] if path.exists()]
    if taken:
        raise GraphError(f"{taken[0]} is there already", fix="choose another name, or remove it")
    made = [path for path in texts if not path.exists()]
    for path in made:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = (_TEMPLATES / texts[path]).read_text(encoding="utf-8")
        text = re.sub(r"\{(\w+)\}", lambda match: names.get(match[1], match[0]), text)
        path.write_text(text, encoding="utf-8")
    return made


def offered(project: Path, package: str) -> bool:
    """Whether the pyproject.toml `project` names the `package` as one of node types."""
    import tomllib

    try:
        said = tomllib.loads(project.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise GraphError(f"{project} cannot be read: {error}") from None
    return package in said.get("project", {}).get("entry-points", {}).get("exmesh.nodes", {}).values()
