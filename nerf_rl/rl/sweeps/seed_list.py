"""Seeds as words: ``0..19`` or ``0,3,5``."""

import re

from nerf_rl.arguments.limits import MOST_SEED
from nerf_rl.errors import UserError

MOST_SEEDS = 1000
_EXAMPLES = "such as 0..19 or 0,3,5"


def parse_seeds(words: str) -> list[int]:
    """Return the seeds that are meant, in order; both ends of a range count.

    Raises:
        UserError: these are no seeds, one is named twice, or they are too many.
    """
    seeds: list[int] = []
    for part in words.split(","):
        found = re.fullmatch(r"\s*(\d{1,12})(?:\.\.(\d{1,12}))?\s*", part, re.ASCII)
        if found is None:
            raise UserError(f"--seeds takes seeds {_EXAMPLES}, got '{words}'")
        first, last = int(found[1]), int(found[2] or found[1])
        if last < first:
            raise UserError(f"--seeds {part.strip()} ends before it begins; write {last}..{first}")
        if last > MOST_SEED:
            raise UserError(f"--seeds must be from 0 to {MOST_SEED}, got {last}")
        if len(seeds) + last - first + 1 > MOST_SEEDS:
            raise UserError(f"--seeds names more than {MOST_SEEDS} seeds; use several sweeps")
        seeds += range(first, last + 1)
    twice = sorted({seed for seed in seeds if seeds.count(seed) > 1})
    if twice:
        raise UserError(f"--seeds names seed {twice[0]} twice")
    return sorted(seeds)
