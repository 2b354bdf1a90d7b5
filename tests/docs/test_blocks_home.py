"""Every code block of the project's own pages is run."""

import pytest
from code_blocks import Block, blocks
from world import World

PAGES = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"]


@pytest.mark.parametrize("block", [block for page in PAGES for block in blocks(page)], ids=str)
def test_a_block_does_what_it_says(block: Block, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    world.run(block, monkeypatch)
