"""Drawing to inline SVG: one restrained style, byte-reproducible, no reference to the outside."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colour-blind safe palette; before and after also differ by marker or line.
BEFORE, AFTER, NEUTRAL, FAINT = "#D55E00", "#0072B2", "#4D4D4D", "#C8C8C8"

_STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": NEUTRAL,
    "axes.labelcolor": "#222222",
    "axes.linewidth": 0.7,
    "axes.grid": False,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "xtick.color": NEUTRAL,
    "ytick.color": NEUTRAL,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.3,
    # Names of parameters come from files: never read them as formulae.
    "text.parse_math": False,
    "path.simplify": True,
    "timezone": "UTC",
}
_FONTS = "font-family: 'DejaVu Sans', Verdana, 'Segoe UI', sans-serif"
_IDENTIFIER = re.compile(r'\sid="([^"]+)"')


def draw(
    name: str,
    title: str,
    size: tuple[float, float],
    plot: Callable[[Figure], None],
) -> str:
    """Return ``<svg>`` text of what ``plot`` draws on an empty figure.

    Parameters
    ----------
    name : prefix of the identifiers inside, unique in the page
    title : text for readers who do not see the picture
    size : width and height [inch]
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with mpl.rc_context():
        # The user's matplotlibrc must not change the bytes.
        mpl.rcdefaults()
        parameters: Any = mpl.rcParams
        parameters.update({**_STYLE, "svg.hashsalt": f"stcal-{name}"})
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasSVG(figure)
        plot(figure)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None}, transparent=True)
    return _inline(stream.getvalue(), name, title, 96.0 * size[0])


def start_axes(axes: Axes, title: str, x: str, y: str, grid: str = "y") -> None:
    """Give the axes their title, labels with units, and a light grid behind the data."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_axisbelow(True)
    if grid == "x":
        axes.grid(True, axis="x")
    elif grid == "y":
        axes.grid(True, axis="y")


def _inline(svg: str, name: str, title: str, width_px: float) -> str:
    """Strip what only a stand-alone file needs; keep the identifiers that are referred to."""
    from html import escape

    body = svg[svg.index("<svg") :].rstrip()
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", body, flags=re.DOTALL)
    body = re.sub(r"<!--.*?-->\s*", "", body, flags=re.DOTALL)
    body = body.replace("xlink:href=", "href=")
    body = re.sub(
        r"font: ((?:\w+ )*)([\d.]+)px [^;\"]*", rf"font: \1\2px sans-serif; {_FONTS}", body
    )
    used = set(re.findall(r"#([\w.-]+)", body))
    body = _IDENTIFIER.sub(lambda m: f' id="{name}-{m[1]}"' if m[1] in used else "", body)
    for identifier in sorted(used, key=len, reverse=True):
        body = body.replace(f'href="#{identifier}"', f'href="#{name}-{identifier}"')
        body = body.replace(f"url(#{identifier})", f"url(#{name}-{identifier})")
    view = re.search(r'viewBox="([^"]*)"', body)
    head = (
        f'<svg viewBox="{view[1] if view else ""}" role="img" style="max-width:{width_px:.0f}px">'
    )
    return re.sub(r"<svg [^>]*>", lambda _: f"{head}<title>{escape(title)}</title>", body, count=1)


def plain_numbers(axis: Any) -> None:
    """Label the major ticks of a logarithmic axis with plain numbers, and no others.

    Of a range within a decade, matplotlib labels minor ticks too, in its markup of formulas.
    """
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(lambda value, _: "")
