"""Figures for papers: at the widths of journal columns, with letters of 8 pt that stay letters.

Figures are drawn for reports, with letters of 10 pt. For print they are drawn again, less wide, and the whole
is scaled down, so that lines and marks keep their proportion to the letters.
"""

from __future__ import annotations

import io
import re
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_pdf import Op, PdfFile, RendererPdf
from matplotlib.figure import Figure

from .style import LOOK, drawn_again

INCH = 25.4  # mm
COLUMN, PAGE = 88.0, 181.0  # mm: one and two columns of most journals
LETTERS = 8.0 / 10.0  # size of letters to that in reports
WIDER = 1.2  # from so many times the width of a column on, a figure takes both
DOTS = 600  # per inch
FORMATS = ("svg", "pdf", "png")
# Letters as text; TrueType, because journals refuse fonts of type 3; the same file for the same figure.
LOOK_IN_PRINT = LOOK | {"svg.fonttype": "none", "svg.hashsalt": "gtr", "pdf.fonttype": 42}


def printed(fig: Figure, ending: str) -> bytes:
    """A figure for a paper, one column (88 mm) wide, or, if it is wide, two (181 mm).

    Args:
        fig: as drawn by a function that is `styled`.
        ending: one of FORMATS: "svg", "pdf", or "png" with 600 dots per inch.
    """
    column = COLUMN / INCH / LETTERS
    drawn = drawn_again(fig, column)
    wide = drawn.get_figwidth()
    scale = (COLUMN if wide <= WIDER * column else PAGE) / INCH / wide
    with mpl.rc_context(LOOK_IN_PRINT):
        return {"svg": _svg, "pdf": _pdf, "png": _png}[ending](drawn, scale)


def _png(fig: Figure, scale: float) -> bytes:
    stream = io.BytesIO()
    fig.savefig(stream, format="png", dpi=DOTS * scale, metadata={"Software": None})
    return stream.getvalue()


def _svg(fig: Figure, scale: float) -> bytes:
    stream = io.StringIO()
    fig.savefig(stream, format="svg", dpi=DOTS * scale, metadata={"Date": None})
    head, svg, rest = stream.getvalue().partition("<svg ")
    for side, length in zip(("width", "height"), fig.get_size_inches(), strict=True):
        rest = re.sub(rf'{side}="[\d.]+pt"', f'{side}="{INCH * scale * length:.3f}mm"', rest, count=1)
    return (head + svg + rest).encode()


def _pdf(fig: Figure, scale: float) -> bytes:
    # As matplotlib writes a figure, on a page of another size and after a change of scale.
    stream = io.BytesIO()
    width, height = fig.get_size_inches()
    fig.dpi = 72  # points
    file = PdfFile(stream, metadata={"CreationDate": None})
    try:
        file.newPage(scale * width, scale * height)
        file.width, file.height = width, height  # beyond which it leaves out what it draws
        file.output(scale, 0, 0, scale, 0, 0, Op.concat_matrix)
        vector = RendererPdf(file, DOTS * scale, height, width)
        renderer: Any = MixedModeRenderer(fig, width, height, DOTS * scale, vector)
        fig.draw(renderer)
        renderer.finalize()
        file.finalize()
    finally:
        file.close()
    return stream.getvalue()
