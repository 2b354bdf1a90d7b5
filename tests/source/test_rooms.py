"""The package's rooms: small, and with imports that point one way."""

import ast
import collections
import functools
import graphlib
from collections.abc import Iterator
from pathlib import Path

import nerf_rl

ROOT = Path(nerf_rl.__file__).parent
ORDER = [
    "machine files arguments cameras pictures hub",
    "scenes",
    "rendering",
    "datasets",
    "pretrain",
    "rl",
    "tuning",
    "viewer report doctor push",
]
"""Packages from the lowest to the highest; those of a line are neighbours."""
MOST_FILES = 15


@functools.cache
def modules() -> dict[str, Path]:
    """Return every module's file by its name."""
    names = {}
    for path in ROOT.rglob("*.py"):
        parts = ("nerf_rl", *path.relative_to(ROOT).with_suffix("").parts)
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return names


def imports(path: Path, known: dict[str, Path]) -> Iterator[str]:
    """Yield the package's modules that a file imports, those inside functions and for types alone too."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "nerf_rl":
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in known else node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] == "nerf_rl")


@functools.cache
def graph() -> dict[str, set[str]]:
    known = modules()
    found = {name: set(imports(path, known)) - {name, "nerf_rl"} for name, path in known.items()}
    assert sum(map(len, found.values())) > 300  # otherwise nothing has been read
    return found


def test_no_module_is_in_an_import_circle():
    list(graphlib.TopologicalSorter(graph()).static_order())  # a circle is an error that names its modules


def test_imports_between_packages_point_one_way():
    height = {package: level for level, line in enumerate(ORDER) for package in line.split()}
    assert {path.name for path in ROOT.iterdir() if (path / "__init__.py").is_file()} == set(height)
    upward = []
    for module, wanted in graph().items():
        for other in wanted:
            here, there = module.split(".")[1:2], other.split(".")[1:2]
            if here and there and here != there and {*here, *there} <= set(height):
                upward += [(module, other)] if height[here[0]] < height[there[0]] else []
    assert upward == []


def test_imports_between_the_rooms_of_a_package_point_one_way():
    """Its own files, which hold its keys and its commands, stand beside its rooms."""
    rooms = collections.defaultdict(set)
    for module, wanted in graph().items():
        for other in wanted:
            here, there = (modules()[name].parent.relative_to(ROOT).parts for name in (module, other))
            if here[:1] == there[:1] and here != there and len(here) == len(there) == 2:
                rooms[here].add(there)
    assert rooms
    list(graphlib.TopologicalSorter(rooms).static_order())


def test_no_folder_is_crowded():
    rooms = [ROOT, ROOT.parent / "tests", ROOT.parent / "tools"]
    paths = [path for room in rooms for path in room.rglob("*.py")]
    files = collections.Counter(path.parent for path in paths if path.name != "__init__.py")
    assert sum(files.values()) > 400
    assert {str(folder): count for folder, count in files.items() if count > MOST_FILES} == {}


def test_every_package_says_what_is_in_it():
    for path in ROOT.rglob("__init__.py"):
        text = ast.get_docstring(ast.parse(path.read_text()))
        assert text and text.endswith("."), f"{path} says nothing"
