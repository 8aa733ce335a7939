"""How figures look: legible on paper, in gray, and for color-blind readers."""

import io
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

# Okabe and Ito's palette, which color-blind readers can tell apart, darkest first so that it also survives gray print
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00", "#56B4E9")
STYLE: Any = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.5,
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#444444",
    "lines.linewidth": 1.4,
    "lines.markersize": 4.0,
    "legend.frameon": False,
    "savefig.facecolor": "white",
    "svg.fonttype": "path",
    "svg.hashsalt": "emran_sumo",
    "pdf.fonttype": 42,
    "figure.constrained_layout.use": True,
}


def image(figure: Figure, kind: str, dots: int = 200) -> bytes:
    """A figure as "svg", "png" or "pdf"; equal figures give equal bytes. dots: per inch, of a PNG."""
    sink = io.BytesIO()
    with mpl.rc_context(STYLE):
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
        figure.savefig(sink, format=kind, dpi=dots, metadata=dates)
    return sink.getvalue()
