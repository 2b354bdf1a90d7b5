"""Parquet files as LeRobot reads them: frames, episodes and tasks."""

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy import ndarray

from nerf_rl.files.atomic import atomic_write
from nerf_rl.machine.extras import import_extra


@contextlib.contextmanager
def open_frames(path: Path) -> Iterator[Callable[[Mapping[str, ndarray]], None]]:
    """Give a function that adds an episode's columns to a file, which exists whole or not at all.

    Each episode is a row group of its own, so that one can be read without the others.
    """
    parquet = load_parquet()
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as aside, contextlib.ExitStack() as stack:
        writers: list[Any] = []

        def append(columns: Mapping[str, ndarray]) -> None:
            arrow = import_extra("pyarrow", "lerobot", "--format lerobot")
            table = arrow.table({name: _array(arrow, values) for name, values in columns.items()})
            if not writers:
                writers.append(stack.enter_context(parquet.ParquetWriter(aside, table.schema)))
            writers[0].write_table(table)

        yield append


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows of numbers, texts and lists, whole or not at all."""
    arrow = import_extra("pyarrow", "lerobot", "--format lerobot")
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as aside:
        load_parquet().write_table(arrow.Table.from_pylist([dict(row) for row in rows]), aside)


def write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write the instructions, which pandas is to read as the index of a table."""
    arrow = import_extra("pyarrow", "lerobot", "--format lerobot")
    table = arrow.table({"task_index": np.arange(len(tasks)), "task": list(tasks)})
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    described = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": stored, "metadata": None}
        for name, (kind, stored) in kinds.items()
    ]
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": described, "pandas_version": "2.0.0"}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as aside:
        load_parquet().write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas)}), aside)


def load_parquet() -> ModuleType:
    """Import PyArrow's reader and writer of Parquet; raise UserError if it is not installed."""
    return import_extra("pyarrow.parquet", "lerobot", "--format lerobot")


def _array(arrow: ModuleType, values: ndarray) -> Any:
    """Turn [T, ...] into an array of T numbers, lists or lists of lists."""
    column = arrow.array(np.ascontiguousarray(values).reshape(-1))
    if values.ndim == 2:
        return arrow.FixedSizeListArray.from_arrays(column, values.shape[1])
    for length in reversed(values.shape[1:]):
        offsets = arrow.array(np.arange(0, len(column) + 1, length, dtype=np.int32))
        column = arrow.ListArray.from_arrays(offsets, column)
    return column
