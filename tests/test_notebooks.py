from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[1] / "notebooks"
each_notebook = pytest.mark.parametrize("name", sorted(p.name for p in FOLDER.glob("*.ipynb")))


QUICK = "1_the_filter.ipynb"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(p.name, marks=[pytest.mark.slow] * (p.name != QUICK))
        for p in sorted(FOLDER.glob("*.ipynb"))
    ],
)
def test_it_runs_from_a_clean_kernel(name, tmp_path, monkeypatch):
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))  # neither a user's profile nor history
    notebook = nbformat.read(FOLDER / name, as_version=4)
    client = NotebookClient(notebook, timeout=600, resources={"metadata": {"path": FOLDER}})
    client.execute(cwd=FOLDER)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not [o.text for o in outputs if o.output_type == "stream" and "Warning: " in o.text]


@each_notebook
def test_its_outputs_are_stripped(name):
    cells = nbformat.read(FOLDER / name, as_version=4).cells
    code = [cell for cell in cells if cell.cell_type == "code"]
    assert code
    assert not [k for k, cell in enumerate(code) if cell.outputs or cell.execution_count]
