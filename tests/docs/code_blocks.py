"""The pages of the documentation and the code blocks in them, found by the library that also makes the site of them."""

import ast
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

import markdown

ROOT = Path(__file__).parents[2]
SHELL = {".", "export", "make", "nerf-rl", "optuna-dashboard", "pip", "python", "srun", "torchrun"}
"""What a line of a shell's block begins with."""


@dataclass(frozen=True)
class Block:
    """A fenced or indented code block."""

    page: str
    number: int
    text: str

    def __str__(self) -> str:
        return f"{self.page}-{self.number}"

    @property
    def kind(self) -> str:
        """``shell``, ``python`` or ``text``, by what it says."""
        first = {line.split()[0] for line in self.text.replace("\\\n", " ").splitlines() if line.strip()}
        if first <= SHELL:
            return "shell"
        try:
            ast.parse(self.text)
        except SyntaxError:
            return "text"
        return "python"


def pages() -> list[str]:
    """Return every page by its path from the root."""
    found = [*ROOT.glob("*.md"), *ROOT.glob("[!.]*/README.md"), *ROOT.glob("docs/**/*.md")]
    return sorted({path.relative_to(ROOT).as_posix() for path in found})


def blocks(page: str) -> list[Block]:
    """Return the code blocks of a page, from the top."""
    reader = _Reader()
    reader.feed(markdown.markdown((ROOT / page).read_text(), extensions=["fenced_code", "tables"]))
    return [Block(page, number, text) for number, text in enumerate(reader.blocks)]


class _Reader(HTMLParser):
    """Collects the texts of preformatted elements."""

    def __init__(self) -> None:
        super().__init__()
        self.blocks: list[str] = []
        self._inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "pre":
            self._inside = True
            self.blocks.append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = self._inside and tag != "pre"

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.blocks[-1] += data
