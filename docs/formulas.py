"""Formulas as SVG inside the page, typeset by matplotlib: needs neither TeX nor a network."""

import re
from functools import cache
from io import BytesIO
from typing import Any

import matplotlib
from docutils.nodes import SkipNode
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import math_to_image

FONT = FontProperties(size=12, math_fontfamily="cm")
PT_PER_EM = 12.0


@cache
def svg(latex: str) -> str:
    """A formula as one SVG element, aligned with the baseline of its line."""
    text = f"${' '.join(latex.split())}$"
    data = BytesIO()
    # A fixed salt gives the same page from every build.
    with matplotlib.rc_context({"svg.hashsalt": "formula", "svg.fonttype": "path"}):
        depth = math_to_image(text, data, prop=FONT, dpi=72, format="svg")
    whole = data.getvalue().decode()
    drawing = re.sub(
        r"<metadata>.*?</metadata>|<g id=\"patch_1\">.*?</g>", "", whole[whole.index("<svg") :], flags=re.S
    )
    width, height = (float(re.search(rf'{name}="([\d.]+)pt"', drawing)[1]) / PT_PER_EM for name in ("width", "height"))
    look = f"width:{width:.3f}em;height:{height:.3f}em;vertical-align:{-depth / PT_PER_EM:.3f}em"
    spoken = latex.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    return drawing.replace("<svg", f'<svg class="formula" role="img" aria-label="{spoken}" style="{look}"', 1).strip()


def inline(translator: Any, node: Any) -> None:
    """Write an inline formula."""
    translator.body.append(svg(node.astext()))
    raise SkipNode


def block(translator: Any, node: Any) -> None:
    """Write a display formula."""
    translator.body.append(f'<div class="formula">{svg(node.astext())}</div>')
    raise SkipNode


def setup(app: Any) -> None:
    """Register the renderer with Sphinx under the name used in conf.py."""
    app.add_html_math_renderer("matplotlib", inline_renderers=(inline, None), block_renderers=(block, None))
