"""The notebooks of the documentation run, cell after cell."""

import json
from pathlib import Path

import matplotlib as mpl
import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def cells(path, kind):
    """The text of the cells of a kind."""
    found = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in found if cell["cell_type"] == kind]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_from_top_to_bottom(path, monkeypatch):
    mpl.use("Agg")
    monkeypatch.chdir(ROOT)
    names = {"__name__": "__main__"}
    for number, text in enumerate(cells(path, "code"), 1):
        exec(compile(text, f"{path.name}, cell {number}", "exec"), names)
    import matplotlib.pyplot as plt

    assert plt.get_fignums()
    plt.close("all")


def test_there_are_two_and_they_hold_no_output():
    assert [path.stem for path in NOTEBOOKS] == ["piles", "survey"]
    for path in NOTEBOOKS:
        found = json.loads(path.read_text(encoding="utf-8"))
        assert found["nbformat"] == 4
        assert not any(cell.get("outputs") for cell in found["cells"])
        for text in [*cells(path, "code"), *cells(path, "markdown")]:
            assert max(map(len, text.splitlines())) <= 100
