import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from recordings_helpers import sequences

from jaxreplay import Records
from jaxreplay.figures.inspection import MARKS, inspection_figure
from jaxreplay.recordings.inspect import inspect


def marked(image):
    """Pixels in the colour of the first record that findings name."""
    values = np.asarray(image.convert("RGB"), int)
    first = 255 * np.array(to_rgb(MARKS[0]["color"]))
    return np.sum(np.abs(values - first).max(axis=2) < 10)


def test_the_figure_marks_what_was_found(tmp_path):
    sensors, commands = sequences()
    images = []
    for name in ("clean.png", "spike.png"):
        records = Records.from_sequences(sensors, commands, period=0.1)
        inspection_figure(records, inspect(records)).savefig(tmp_path / name)
        with Image.open(tmp_path / name) as image:
            assert image.width == 1200
            images.append(marked(image))
        sensors[2][20, 0] = 30
    assert images[0] == 0
    assert images[1] > 200


@pytest.mark.parametrize(("n", "n_s", "length"), [(1, 1, 1), (50, 1, 12), (2, 20, 12)])
def test_the_figure_is_drawn_for_few_and_many(tmp_path, n, n_s, length):
    rng = np.random.default_rng(0)
    both = [[rng.normal(size=(length, k)) for _ in range(n)] for k in (n_s, 2)]
    records = Records.from_sequences(*both)
    inspection_figure(records, inspect(records)).savefig(tmp_path / "shown.png")
    with Image.open(tmp_path / "shown.png") as image:
        panels = -(-(n_s + 3) // (2 if n_s < 4 else 3))
        assert image.size == (1200, pytest.approx(150 * (1.45 * panels + 0.5), abs=1))


def test_names_with_dollars_are_drawn_as_they_are(tmp_path):
    rows = np.linspace(0, 1, 30)[:, None] ** [1.0, 2.0]
    records = Records.from_sequences([rows] * 2, [rows] * 2, ["$\\x$", "a$b"], ["$$", "u"])
    inspection_figure(records, inspect(records)).savefig(tmp_path / "names.png")
