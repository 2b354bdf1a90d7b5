"""Every code block of the pages in docs/ is run."""

import pytest
from code_blocks import Block, blocks, pages
from world import World

PAGES = [page for page in pages() if page.startswith("docs/")]


@pytest.mark.parametrize("block", [block for page in PAGES for block in blocks(page)], ids=str)
def test_a_block_does_what_it_says(block: Block, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    world.run(block, monkeypatch)
