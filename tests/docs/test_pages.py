"""The documentation as a whole: blocks that are run, links that lead somewhere, tables that are up to date."""

import ast
import importlib
import re
from pathlib import Path

import pytest
import yaml
from code_blocks import ROOT, SHELL, Block, blocks, pages
from not_run import LINES, LISTINGS, TEXTS
from world import SMALLER, commands_of

from nerf_rl.cli import COMMANDS
from nerf_rl.viewer.subject import RESUMED
from tools.compare import ablation, tasks
from tools.compare.agent_runs import read_entries
from tools.page_tables import AGENTS_PAGE, write_tables
from tools.record import choices, recipe_agents

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
MOST_BYTES = 300_000  # of a picture


def pages_run() -> list[str]:
    """Return the pages that the test files beside this one run."""
    names = [path.stem for path in sorted(Path(__file__).parent.glob("test_blocks_*.py"))]
    return sorted(page for name in names for page in importlib.import_module(name).PAGES)


def slug(heading: str) -> str:
    """Return a heading's anchor, as GitHub and MkDocs make it."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def anchors(text: str) -> set[str]:
    return {slug(heading) for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE)}


def test_every_page_is_run_by_one_test_file() -> None:
    assert pages_run() == pages()
    assert sum(len(blocks(page)) for page in pages()) > 45


def test_fenced_and_indented_blocks_are_found_those_in_lists_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "A\n\n    make a\n\n    make b\n\n```python\nx = '<1>'\n```\n\n- b\n\n        y = 2\n\n`no` block\n"
    (tmp_path / "page.md").write_text(text)
    monkeypatch.setattr("code_blocks.ROOT", tmp_path)
    assert [block.text for block in blocks("page.md")] == ["make a\n\nmake b\n", "x = '<1>'\n", "y = 2\n"]
    assert [block.kind for block in blocks("page.md")] == ["shell", "python", "python"]


@pytest.mark.parametrize(
    "text, kind",
    [
        ("nerf-rl view a   # b\n", "shell"),
        ("make a\nnerf-rl view \\\n    b\n", "shell"),
        ("a.json    what it is\n", "text"),
        ("env = ...\n", "python"),
        ("curl http://example.org | sh\n", "text"),
    ],
)
def test_a_block_is_of_the_kind_that_it_looks_like(text: str, kind: str) -> None:
    assert Block("page", 0, text).kind == kind


def test_what_is_not_run_stands_in_some_page_and_has_a_reason() -> None:
    every = [block for page in pages() for block in blocks(page)]
    lines = {" ".join(words) for block in every if block.kind == "shell" for words in commands_of(block.text)}
    assert set(LINES) <= lines
    for begin in {**TEXTS, **LISTINGS}:
        assert any(block.kind == "text" and block.text.startswith(begin) for block in every), begin
    for words in SMALLER:
        assert any(words in block.text for block in every), words
    assert all(LINES.values()) and all(TEXTS.values())
    assert {line.split()[0] for line in lines} <= SHELL


@pytest.mark.parametrize("page", pages())
def test_a_goal_is_in_quotes_since_a_shell_takes_its_sign_for_a_redirection(page: str) -> None:
    assert not re.findall(r"--stop_when [^\s\"']*[<>].*", (ROOT / page).read_text())


@pytest.mark.parametrize("page", pages())
def test_every_relative_link_leads_to_a_file_and_every_anchor_to_a_heading(page: str) -> None:
    folder, text = (ROOT / page).parent, (ROOT / page).read_text()
    for link in LINK.findall(text):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (folder / name).resolve() if name else ROOT / page
        assert target.is_relative_to(ROOT) and target.is_file(), f"{page} links to {link}"
        if anchor:
            assert anchor in anchors(target.read_text()), f"{page} links to {link}"


def test_every_page_is_in_the_navigation_and_every_entry_of_it_is_a_page() -> None:
    # the file names no Python objects, but Material's way of asking for emoji would
    navigation = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    assert sorted(re.findall(r"[\w/-]+\.md", str(navigation))) == pages()


def test_what_pages_import_from_the_package_is_in_the_api_reference() -> None:
    described = {
        name
        for page in pages()
        if "/api/" in page
        for name in re.findall(r"^::: (\S+)", (ROOT / page).read_text(), re.M)
    }
    imported = set()
    for block in (block for page in pages() for block in blocks(page) if block.kind == "python"):
        for node in ast.walk(ast.parse(block.text)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("nerf_rl."):
                imported |= {(node.module, alias.name) for alias in node.names}
    assert len(imported) > 8
    assert {f"{module}.{name}" for module, name in imported if not {module, f"{module}.{name}"} & described} == set()


def test_a_table_takes_its_place_in_a_page_and_is_refused_where_it_has_none(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- table: a -->\nold\n<!-- end -->\n<!-- table: b -->\nkept\n<!-- end -->\n")
    write_tables(page, {"a": "| new |"})
    text = "before\n<!-- table: a -->\n| new |\n<!-- end -->\n<!-- table: b -->\nkept\n<!-- end -->\n"
    assert page.read_text() == text
    with pytest.raises(ValueError, match=r"page.md has no marker for the tables \['c'\]"):
        write_tables(page, {"b": "| other |", "c": "| lost |"})
    assert page.read_text() == text, "all or nothing"


def test_the_tables_of_choices_hold_what_the_result_files_say() -> None:
    text = choices.PAGE.read_text()
    for name, table in choices.tables().items():
        assert f"<!-- table: {name} -->\n{table}\n<!-- end -->" in text, "run tools/record/choices.py"


def test_the_tables_of_the_recipes_agents_hold_what_the_result_files_say() -> None:
    results = ROOT / recipe_agents.RESULTS
    table, summary = recipe_agents.table(results), recipe_agents.summary(results)
    told = dict.fromkeys(recipe_agents.SUMMARY_PAGES, f"recipe-summary -->\n{summary}\n<!-- end -->")
    told[AGENTS_PAGE] = f"recipe-agents -->\n{table}\n<!-- end -->"
    for page, text in told.items():
        assert f"<!-- table: {text}" in (ROOT / page).read_text(), f"run tools/record/recipe_agents.py for {page}"
    assert table.count("\n") > 8 and summary.count("\n") > 6


def test_the_table_of_what_was_left_out_holds_what_the_result_file_says() -> None:
    entries = read_entries(ROOT / ablation.RESULT, "ablation")
    table = ablation.table(entries)
    assert f"<!-- table: ablation -->\n{table}\n<!-- end -->" in (ROOT / AGENTS_PAGE).read_text()
    for entry in entries:
        assert entry["keys"] == ablation.WITHOUT[entry["without"]], "they are of keys that say something else by now"


def test_what_an_encoder_misses_is_what_is_read_farther_off_or_found_less_than_asked() -> None:
    def probe(**columns: float) -> dict[str, dict[str, float]]:
        return {name: {"rmse_mm": error} for name, error in columns.items()}

    row = {
        "probe": probe(hand_x=6.1, hand_y=5.9, handle_x=5.9, object_x=7.4, object_y=7.6, goal_x=4.9),
        "probe_supervised_encoder": probe(hand_x=9.0, hand_y=1.0, handle_x=4.0, object_x=6.0, object_y=6.0, goal_x=1.0),
        "class_iou": {"robot": 0.59, "drawer": 0.61, "gripper": 0.41, "ball": 0.39, "unseen": None},
        "class_share": {"robot": 0.01, "drawer": 0.01, "gripper": 0.009, "ball": 0.009, "unseen": 0.5},
    }
    assert tasks.misses(row) == ["hand_x", "handle_x", "object_y", "robot", "ball"]


def test_a_summary_of_seeds_tells_their_mean_and_the_worst() -> None:
    assert recipe_agents.mean_and_worst([0.5, 1.0, 0.9]) == "80 (50)"
    assert recipe_agents.mean_and_worst([0.25]) == "25 (one seed)"
    assert recipe_agents.mean_and_worst([]) == ""


def test_success_rates_that_are_the_same_are_told_together() -> None:
    assert recipe_agents.rates([0.86, 0.98, 0.98, 1.0, 1.0, 1.0]) == "86, 2 times 98, 3 times 100"
    assert recipe_agents.rates([]) == ""


def test_the_gallery_shows_every_task_of_metaworld() -> None:
    from metaworld.env_dict import ENV_CLS_MAP

    text = (ROOT / "docs" / "gallery.md").read_text()
    shown = re.findall(r"`([\w-]+-v3)`", text)
    assert sorted(shown) == sorted(ENV_CLS_MAP) and len(shown) == 50


def test_pictures_are_small() -> None:
    pictures = list((ROOT / "docs" / "pictures").iterdir())
    assert len(pictures) > 5
    assert {path.name for path in pictures if path.stat().st_size > MOST_BYTES} == set()


def test_the_commands_that_go_on_where_they_were_interrupted_are_those_with_the_key() -> None:
    (told,) = re.findall(r"`--resume true` continues([^.]*)\.", (ROOT / "README.md").read_text())
    configs = {name: command.config.split(":") for name, command in COMMANDS.items()}
    keys = {name: getattr(importlib.import_module(module), config) for name, (module, config) in configs.items()}
    resumable = {name for name, config in keys.items() if hasattr(config, "resume")}
    assert set(re.findall("`([a-z-]+)`", told)) == resumable == set(RESUMED)
