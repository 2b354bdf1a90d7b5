"""Mutated files of every kind, read by the real commands and loaders: a result or one sentence, and nothing else.

``tools/fuzz/inputs.py`` does the same at length.
"""

import importlib
import pickle
import random
from pathlib import Path

import numpy as np
import pytest

from tools.fuzz import inputs, mutations
from tools.fuzz.targets import KINDS, OUTCOMES, Base, Targets

NUMBERS = range(1000, 1020)


@pytest.fixture(scope="module")
def base(tiny_recipe: Path, tiny_dataset: Path, tiny_encoder: Path, tiny_agent: Path) -> Base:
    """Good files."""
    return Base(tiny_recipe, tiny_dataset, tiny_encoder, tiny_agent)


def test_mutated_files_give_a_result_or_a_sentence(base: Base):
    table, examples = inputs.fuzz(base, KINDS, NUMBERS, seed="short", every=10**6)
    assert not examples, examples[0]["text"]
    for kind in KINDS:
        assert sum(table[kind].values()) == len(NUMBERS)
        assert sum(table[kind][outcome] for outcome in OUTCOMES[2:]) == 0
        assert table[kind]["sentences"] > len(NUMBERS) // 4  # most mutations are found out


def test_a_mutation_is_the_same_whenever_it_is_made(tmp_path: Path):
    content = np.random.default_rng(0).bytes(500)
    made = [mutations.mutated_bytes(content, random.Random(f"{seed}"), [b"other"]) for seed in (*range(40), *range(40))]
    assert made[:40] == made[40:] and len(set(made)) > 30


def test_executed_code_would_be_noticed(base: Base, tmp_path: Path):
    targets = Targets(base, tmp_path / "scratch", every=1)
    assert not targets.executed()
    pickle.loads(pickle.dumps(mutations.Payload(targets.marker)))
    assert targets.executed() and not targets.executed()
    for _ in range(2):
        importlib.import_module(mutations.MODULE)
        assert targets.executed() and not targets.executed()
