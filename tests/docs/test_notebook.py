"""The notebook of examples, run from its first cell to its last: only episodes, steps and pixels are fewer."""

import base64
from collections.abc import Iterator
from pathlib import Path

import cv2
import nbclient
import nbformat
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "examples" / "from_scene_to_policy.ipynb"
MOST_BYTES = 100_000
MOST_SECONDS = 180  # of a cell; on two idle cores the whole notebook takes a minute
FEWER = {
    "EPISODES": 12,
    "PIXELS": 24,
    "ENCODER_STEPS": 4,
    "VALIDATION_FRAMES": 1,
    "AGENT_STEPS": 330,
    "WARMUP_STEPS": 300,  # enough for updates with the recipe's batch
    "EVALUATION_EPISODES": 1,
}


def read() -> nbformat.NotebookNode:
    return nbformat.read(NOTEBOOK, as_version=4)


def parameters(notebook: nbformat.NotebookNode) -> int:
    """Return where the cell is that says the sizes."""
    (place,) = [i for i, cell in enumerate(notebook.cells) if "parameters" in cell.metadata.get("tags", [])]
    return place


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> nbformat.NotebookNode:
    """The notebook with its outputs, run in a folder of its own; a cell that fails ends it with what it said."""
    notebook, folder = read(), tmp_path_factory.mktemp("notebook")
    changed = {"CHECKOUT": str(ROOT), "WORK": str(folder / "a run"), **FEWER}
    lines = [f"{name} = {value!r}" for name, value in changed.items()]
    notebook.cells.insert(parameters(notebook) + 1, nbformat.v4.new_code_cell("\n".join(lines)))
    place = {"metadata": {"path": str(folder)}}
    return nbclient.NotebookClient(notebook, timeout=MOST_SECONDS, kernel_name="python3", resources=place).execute()


def outputs(notebook: nbformat.NotebookNode) -> Iterator[nbformat.NotebookNode]:
    return (output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs)


def test_every_cell_runs_and_none_fails(executed: nbformat.NotebookNode):
    ran = [cell.execution_count for cell in executed.cells if cell.cell_type == "code"]
    assert ran == list(range(1, len(ran) + 1))
    assert [output for output in outputs(executed) if output.output_type == "error"] == []


def test_the_pictures_show_something(executed: nbformat.NotebookNode):
    encoded = [output.data["image/png"] for output in outputs(executed) if "image/png" in output.get("data", {})]
    assert len(encoded) == 6  # contact sheet, cameras, projections, reconstructions, learning curve, episode
    for content in encoded:
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(content), np.uint8), cv2.IMREAD_COLOR).astype(int)
        coloured = picture.max(-1) - picture.min(-1) > 40  # axes without content are black on white
        assert coloured.mean() > 0.002


def test_the_commands_and_figures_are_shown(executed: nbformat.NotebookNode):
    printed = "".join(output.text for output in outputs(executed) if output.output_type == "stream")
    assert all(f"$ nerf-rl {command} --config" in printed for command in ("gen-dataset", "pretrain", "train-rl"))
    assert "PSNR" in printed and f"after {FEWER['AGENT_STEPS']} steps" in printed
    tables = [output.data["text/markdown"] for output in outputs(executed) if "text/markdown" in output.get("data", {})]
    assert len(tables) == 1 and "| hand_x |" in tables[0] and " mm |" in tables[0]


def test_its_sizes_stand_in_one_cell_and_all_of_them_are_used():
    notebook = read()
    place = parameters(notebook)
    names = [line.split(" = ")[0] for line in notebook.cells[place].source.splitlines()]
    assert {*FEWER, "CHECKOUT", "WORK"} == set(names)
    rest = "".join(cell.source for cell in notebook.cells[place + 1 :] if cell.cell_type == "code")
    assert [name for name in names if name not in rest] == []


def test_it_is_stored_small_and_without_outputs():
    assert NOTEBOOK.stat().st_size < MOST_BYTES
    cells = [cell for cell in read().cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in cells)
    nbformat.validate(read())
