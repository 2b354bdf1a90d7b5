"""What may have happened to a file before it is handed in: seeded mutations of bytes, trees, tensors and HDF5 files.

Each function takes the content of a good file and a random generator, and returns that of a bad one; the same generator
state gives the same bytes. Payloads create a marker file if they are ever executed.
"""

import contextlib
import copy
import io
import json
import os
import pickle
import random
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch
import yaml

MODULE = "named_in_a_recipe"
"""of a class that stands in the place of keys; who imports it runs it"""
VALUES: list[Any] = [
    None, True, False, 0, -1, 1, 7, 2**31, 2**63, 10**9, 10**30, -(10**9), 0.5, -0.0, 1e308, -1e308, 1e-320,
    float("nan"), float("inf"), "", "x", "../..", "/etc/passwd", "a\nb", "\x00", "ß☃", "1e9", "null", "a" * 5000,
    [], {}, [[]], [1], [0, -1], {"a": 1}, [None, "x", 2.5], [[1, 2], [3]],
    f"{MODULE}.Part", {"class_path": f"{MODULE}.Part"},
]  # fmt: skip
"""what a value may be replaced by"""


class Payload:
    """What an unpickler that trusts its input would execute."""

    def __init__(self, marker: Path):
        self._marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self._marker}",)


_DEEPEST = 100  # place in a tree


def mutated_bytes(content: bytes, rng: random.Random, others: list[bytes]) -> bytes:
    """Return bytes that were flipped, cut, repeated, overwritten, or those of another file."""
    place, other = rng.randrange(len(content) + 1), rng.randrange(len(content) + 1)
    first, last = min(place, other), max(place, other)
    changed = bytearray(content)

    def flipped() -> bytes:
        for _ in range(rng.choice((1, 1, 3, 20))):
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
        return bytes(changed)

    ways: list[Callable[[], bytes]] = [
        flipped,
        flipped,
        lambda: content[:place],
        lambda: content[place:],
        lambda: b"",
        lambda: content[:last] + content[first:last] + content[last:],
        lambda: content[:first] + bytes(last - first) + content[last:],
        lambda: content[:place] + rng.randbytes(rng.choice((1, 8, 200))) + content[place:],
        lambda: content[:first] + b"\xff\xfe" + content[first:],
        lambda: rng.randbytes(rng.choice((1, 100, 5000))),
        lambda: rng.choice(others),
    ]
    return rng.choice(ways)() if content else b"\x00"


def paths_of(tree: Any, path: tuple = ()) -> list[tuple]:
    """Return the places in a tree of mappings and lists, but for those that an earlier mutation has put very deep."""
    if len(path) > _DEEPEST:
        return [path]
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [path, *(place for key, value in items for place in paths_of(value, (*path, key)))]


def at(tree: Any, path: tuple) -> Any:
    """Return what stands at a place."""
    for key in path:
        tree = tree[key]
    return tree


def mutated_tree(tree: Any, rng: random.Random, values: list[Any] = VALUES) -> Any:
    """Return a tree in which one to three things were removed, renamed, replaced, repeated or nested otherwise."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        path = rng.choice(paths_of(tree))
        if not path:
            if rng.random() < 0.2:
                return copy.deepcopy(rng.choice(values))
            continue
        parent, key = at(tree, path[:-1]), path[-1]
        value, way = parent[key], rng.randrange(9)
        if way == 0:
            del parent[key]
        elif way == 1 and isinstance(parent, dict):
            parent[rng.choice((f"{key}x", "", "a.b", "__class__"))] = parent.pop(key)
        elif way == 2 and isinstance(parent, list):
            parent[key:key] = [value] * rng.choice((1, 50))
        elif way == 3:
            parent[key] = [value] if rng.random() < 0.5 else {"a": value}
        elif way == 4 and isinstance(value, (int, float)) and not isinstance(value, bool):
            parent[key] = rng.choice((-value, value * 1000, value + 1, str(value), float(value), value / 3))
        elif way == 5:
            parent[key] = copy.deepcopy(at(tree, rng.choice(paths_of(tree))))
        elif way == 6:
            nested: Any = value
            for _ in range(rng.choice((5, 60, 400))):
                nested = [nested]
            parent[key] = nested
        else:
            parent[key] = copy.deepcopy(rng.choice(values))
    return tree


def mutated_numbers(tree: Any, rng: random.Random) -> Any:
    """Return a tree in which one or two numbers or words became others of their kind, so that it is often read."""
    tree = copy.deepcopy(tree)
    leaves = [path for path in paths_of(tree) if path and not isinstance(at(tree, path), (dict, list))]
    for path in rng.sample(leaves, min(len(leaves), rng.choice((1, 1, 2)))):
        parent, key = at(tree, path[:-1]), path[-1]
        value = parent[key]
        if isinstance(value, bool):
            parent[key] = not value
        elif isinstance(value, int):
            parent[key] = rng.choice(
                (0, -1, 1, 2, 3, value + 1, 3 * value, 10**4, 10**6, 10**9, 2**31, 2**32, 2**63, -(2**63))
            )
        elif isinstance(value, float):
            nan, inf = float("nan"), float("inf")
            parent[key] = rng.choice((0.0, -value, 1e-320, 1e-9, 2 * value, 1e9, 1e308, nan, inf, -inf, 89.9999, 180.0))
        elif isinstance(value, str):
            words = sorted({at(tree, leaf) for leaf in leaves if isinstance(at(tree, leaf), str)})
            parent[key] = rng.choice((*words, "", "x" * 300, "../..", "/dev/zero", "a b", "\n"))
        else:
            parent[key] = rng.choice((0, 1, 0.5, "", [], {}))
    return tree


def mutated_json(content: bytes, rng: random.Random, others: list[bytes], seal: Callable[[Any], Any]) -> bytes:
    """Return JSON of a changed tree, signed anew by ``seal`` in most cases, or changed bytes."""
    way = rng.random()
    if way < 0.2:
        return mutated_bytes(content, rng, others)
    if way < 0.25:
        return b"[" * rng.choice((900, 100_000)) + content
    tree = (mutated_numbers if way < 0.5 else mutated_tree)(json.loads(content), rng)
    if isinstance(tree, dict) and rng.random() < 0.9:
        with warnings.catch_warnings():
            tree = seal(tree)
    return json.dumps(tree, indent=2).encode()


def mutated_yaml(content: bytes, rng: random.Random, others: list[bytes], marker: Path) -> bytes:
    """Return a changed recipe, one with tags that ask for execution, or one that grows without end."""
    way = rng.random()
    if way < 0.2:
        return mutated_bytes(content, rng, others)
    if way < 0.3:
        line = rng.choice(content.decode().splitlines())
        tags = (
            f"!!python/object/apply:os.system ['touch {marker}']",
            f"!!python/object/new:os.system ['touch {marker}']",
            f"!!python/object/apply:subprocess.check_output [['touch', '{marker}']]",
            "!!python/name:os.system",
            "!!timestamp 2001-99-99",
            "!!binary AAAA",
            "!!set {a, b}",
            "&a [*a]",
        )
        return content.replace(line.encode(), f"{line.partition(':')[0]}: {rng.choice(tags)}".encode())
    if way < 0.34:
        levels = [f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 9)}]" for i in range(1, rng.choice((5, 12, 40)))]
        return "\n".join(["l0: &l0 [x]", *levels, ""]).encode() + content
    if way < 0.38:
        return b"rig: " + b"[" * rng.choice((90, 3000, 20000)) + b"\n" + content
    tree = (mutated_numbers if way < 0.75 else mutated_tree)(yaml.safe_load(content), rng)
    try:
        return yaml.safe_dump(tree, allow_unicode=True).encode("utf-8", "surrogatepass")
    except RecursionError:
        return json.dumps(tree).encode()  # which is YAML as well


def mutated_tensors(content: bytes, rng: random.Random, others: list[bytes], marker: Path) -> bytes:
    """Return a safetensors file whose header, values or kind were changed."""
    way = rng.random()
    if way < 0.3:
        return mutated_bytes(content, rng, others)
    if way < 0.36:
        return pickle.dumps({"a": Payload(marker)})
    length = int.from_bytes(content[:8], "little")
    header, values = json.loads(content[8 : 8 + length]), content[8 + length :]
    if way < 0.45:
        lie = rng.choice((0, 1, length - 1, length + 1, len(content), 2**31, 2**40, 2**63, 2**64 - 1))
        return lie.to_bytes(8, "little") + content[8:]
    if way < 0.6:
        return content[: 8 + length] + rng.choice((b"\xff", b"\x7f", b"\x00")) * len(values)
    if way < 0.75:
        name = rng.choice(sorted(header))
        entry = header[name]
        if isinstance(entry, dict) and "shape" in entry:
            entry["shape"] = rng.choice((entry["shape"][::-1], [], [2**40], [2**63, 0], [1, *entry["shape"]], [-1]))
            entry["dtype"] = rng.choice((entry["dtype"], entry["dtype"], "F16", "I64", "BOOL", "F8_E4M3", "C64", "?"))
    else:
        header = mutated_tree(header, rng)
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + values


def mutated_pickle_archive(content: bytes, rng: random.Random, others: list[bytes], marker: Path) -> bytes:
    """Return a PyTorch checkpoint whose tree, tensors or bytes were changed, or one that asks for execution."""
    way = rng.random()
    if way < 0.3:
        return mutated_bytes(content, rng, others)
    if way < 0.36:
        return pickle.dumps({"state_dict": {}, "encoder": Payload(marker)})
    tree = torch.load(io.BytesIO(content), weights_only=True)
    if way < 0.45:
        path = rng.choice([path for path in paths_of(tree) if path])
        at(tree, path[:-1])[path[-1]] = Payload(marker)
    elif way < 0.65:
        path = rng.choice([path for path in paths_of(tree) if isinstance(at(tree, path), torch.Tensor)])
        at(tree, path[:-1])[path[-1]] = _mutated_tensor(at(tree, path), rng)
    else:
        tensors = [torch.zeros(3), torch.zeros(()), torch.full((2, 2), float("nan")), torch.zeros(1).expand(2**40)]
        tree = mutated_tree(tree, rng, [*VALUES, *tensors])
    file = io.BytesIO()
    torch.save(tree, file, _use_new_zipfile_serialization=rng.random() < 0.9)
    return file.getvalue()


def _mutated_tensor(tensor: torch.Tensor, rng: random.Random) -> torch.Tensor:
    ways: list[Callable[[], torch.Tensor]] = [
        lambda: tensor.clone().fill_(float("nan") if tensor.is_floating_point() else -1),
        lambda: tensor.reshape(-1),
        lambda: tensor[None],
        lambda: tensor.double(),
        lambda: tensor.to(torch.int8),
        lambda: torch.zeros(0),
        lambda: torch.zeros(1).expand(2**40),
        lambda: tensor.to_sparse() if tensor.dim() else tensor,
        lambda: torch.empty(tensor.shape, device="meta"),
        lambda: -tensor,
        lambda: tensor * 1e30,
    ]
    return rng.choice(ways)()


def mutated_shard(content: bytes, rng: random.Random, others: list[bytes]) -> bytes:
    """Return a shard of which an array was stored otherwise, or changed bytes, near the beginning in half of cases."""
    way = rng.random()
    if way < 0.2:
        return mutated_bytes(content, rng, others)
    if way < 0.45:
        head = rng.choice((512, 4096, 20_000))
        return mutated_bytes(content[:head], rng, others) + content[head:]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shard.h5"
        path.write_bytes(content)
        with h5py.File(path, "r+") as file:
            names: list[str] = []
            file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
            _restore_otherwise(file, rng.choice(sorted(names)), rng)
            if rng.random() < 1 / 3:
                with contextlib.suppress(
                    KeyError, TypeError, ValueError, OSError, MemoryError
                ):  # what the first has left
                    _restore_otherwise(file, rng.choice(sorted(name for name in names if name in file)), rng)
        return path.read_bytes()


def _restore_otherwise(file: h5py.File, name: str, rng: random.Random) -> None:
    values, way = file[name][()], rng.randrange(14)
    if way == 0:
        file.attrs[rng.choice(("plan", "scene", "renderer"))] = rng.choice((b"", "x" * 1000, 3, np.zeros(4)))
        return
    if way == 1 and values.size and file[name].dtype.kind in "iuf":
        bad = rng.choice((0, 255, -1, 2**31 - 1, np.nan, np.inf, -np.inf, 1e308))
        changed = np.array(values)
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            bad = np.asarray(bad).astype(changed.dtype)
            changed[... if changed.ndim == 0 or rng.random() < 0.5 else rng.randrange(len(changed))] = bad
        file[name][...] = changed
        return
    del file[name]
    if way == 2:
        return
    if way == 3:
        file[name] = h5py.SoftLink(rng.choice(("/rgb", f"/{name}", "/state", "/nothing")))
    elif way == 4:
        file[name] = h5py.ExternalLink(rng.choice(("000000.h5", "/etc/passwd", "/dev/zero")), "/rgb")
    elif way == 5:
        file[name] = file["/"]  # a loop of hard links
    elif way == 6:
        file.create_dataset(name, (10**12,), "u1", chunks=(2**20,), compression="gzip")
    elif way == 7:
        file.create_dataset(name, values.shape, values.dtype, external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])
    elif way == 8:
        file.create_dataset(name, data=rng.choice(("text", b"bytes", [["a", "b"]])))
    else:
        options: list[dict[str, Any]] = [
            {"data": values, "chunks": True} if values.ndim else {"data": values},
            {"data": values, "compression": "gzip"} if values.ndim else {"data": values},
            {"data": values.astype(rng.choice((">f4", "<f2", "<i8", "u1", "<c8"))) if values.dtype.kind != "O" else 1},
            {"data": values[: len(values) // 2] if values.ndim else values},
            {"data": values.reshape(-1)},
            {"data": np.zeros((0, *values.shape[1:]), values.dtype)},
        ]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            file.create_dataset(name, **rng.choice(options))
