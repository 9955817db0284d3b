from pathlib import Path

import pytest
from matplotlib.figure import Figure


@pytest.fixture
def drawn(monkeypatch):
    """The figures that are saved; their files are empty, as rendering takes long."""
    figures = []

    def save(figure, path):
        figures.append(figure)
        Path(path).touch()

    monkeypatch.setattr(Figure, "savefig", save)
    return figures
