"""A figure that a notebook shows by itself."""

from io import BytesIO
from typing import Any

from matplotlib.figure import Figure


def literal(text: str) -> str:
    """Return a text of the user's so that Matplotlib does not take a $ in it for mathematics."""
    return text.replace("$", r"\$")


class Picture(Figure):
    """A Matplotlib figure that a notebook shows without pyplot; `savefig` saves it."""

    def __init__(self, *args: Any, dpi: float = 150, **kwargs: Any):
        """Make an empty figure, with its parts placed so that they do not overlap."""
        super().__init__(*args, dpi=dpi, layout="constrained", **kwargs)

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.savefig(file, format="png")
        return file.getvalue()
