"""Pages of the documentation's site that are not in docs/: the READMEs, and the files that pages link to.

MkDocs calls the functions below (``hooks`` in mkdocs.yml). Every file gets the place in the site that it has in the
checkout, so that a link between two of them is right on both, and no text is kept twice. For the same reason a page
shows a file by the line ``<!-- file: examples/reach_block.py -->``.
"""

import os.path
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

READMES = ("README.md", "datasets/README.md", "pretrain/README.md", "rl/README.md", "CONTRIBUTING.md", "CHANGELOG.md")
_LINK = re.compile(r"\]\(([^)\s#]+)")
_SHOWN = re.compile(r"^<!-- file: (\S+) -->$", re.MULTILINE)
_ROLE = re.compile(r":(?:class|func|meth|mod|attr):(?=<code>)")  # Sphinx's, in docstrings; Markdown knows none


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Return the site's files: what is in docs/ moved to docs/, the READMEs, and what they link to."""
    root = Path(config.config_file_path).parent
    folder = Path(config.docs_dir).relative_to(root)
    pages = {*READMES, *((folder / file.src_uri).as_posix() for file in files if file.is_documentation_page())}
    linked = {target for page in pages for target in linked_files(root, page)}
    ours = [File.generated(config, name, abs_src_path=str(root / name)) for name in sorted(pages | linked)]
    plugins = [file for file in files if not (Path(config.docs_dir) / file.src_uri).is_file()]
    return Files([*ours, *plugins])


def on_page_markdown(markdown: str, config: MkDocsConfig, **others: Any) -> str:
    """Return a page's text with the files in it that it shows."""
    root = Path(config.config_file_path).parent
    return _SHOWN.sub(lambda name: f"```python\n{(root / name[1]).read_text()}```", markdown)


def on_page_content(html: str, **others: Any) -> str:
    """Return a page without what docstrings say to Sphinx."""
    return _ROLE.sub("", html)


def linked_files(root: Path, page: str) -> Iterator[str]:
    """Yield the files, pages aside, that a page links to, by their path from the root; those that exist."""
    for link in _LINK.findall((root / page).read_text()):
        target = os.path.normpath(Path(page).parent / link)
        if not target.endswith(".md") and (root / target).is_file():
            yield target
