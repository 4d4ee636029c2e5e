"""Pages whose code is run when they are built: with how many photons, their downloads, thumbnails of their pictures.

A page is run in a folder of its own by myst-nb. With NAILOPTICS_DOCS=quick in the environment, as tests build them,
commands and functions that trace light take few photons, and recordings few samples.
"""

import hashlib
import json
import os
import re
import sys
from pathlib import Path
from textwrap import TextWrapper
from typing import Any

from docutils import nodes
from docutils.parsers.rst import directives
from nbclient import NotebookClient
from sphinx.util.docutils import SphinxDirective

import nailoptics
from nailoptics.assets import data_dir
from nailoptics.report import style

QUICK = os.environ.get("NAILOPTICS_DOCS") == "quick"
PHOTONS, CALIBRATION_PHOTONS = 5_000, 20_000
# Shipped scenes that pages simulate, and what makes that cheap; one page shows what the priors do.
SHORT = {
    "calibration": {"touch.sample_rate_hz": 12.5, "priors.spread": False},
    "dynamic_proximal": {"touch.sample_rate_hz": 20.0, "priors.spread": False},
    "nail_colour": {"priors.spread": False},
    "prototype": {"priors.spread": False},
}
OF_PRIORS = "tutorials/prototype"
FINGER_WRITTEN = re.compile(r"^%%writefile \S+\n[^`]*^\[finger\]$[^`]*", re.M)
# What stands before the name of a scene.
SIMULATED = ("simulate ", "colour ", 'colour\\("', 'simulate\\("', 'sweep\\("', 'scene\\("', '^base = "')
WRAP = TextWrapper(110, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
CELL = re.compile(r"^```\{code-cell\}.*?^```$", re.M | re.S)
TRACING = re.compile(
    r"^(nailoptics (?:simulate|trace|compare|calibrate|oximeter|colour|place|tradeoff|explain|explore)\b.*)$", re.M
)
LIMIT = re.compile(r" --(?:relative-error|max-seconds|photons) \S+")
LIMIT_IN_PYTHON = re.compile(r"\b(?:relative_error|tolerance|max_seconds|photons)( ?= ?)[\d_.]+")


def with_few_photons(app: Any, name: str, source: list[str]) -> None:
    """Before a page is read: what it runs takes few photons and samples, where pages are only tried."""
    if QUICK and source[0].startswith("---\nfile_format: mystnb"):
        # Of fewer, a calibration is refused.
        photons = CALIBRATION_PHOTONS if "calibrate" in source[0] else PHOTONS
        source[0] = CELL.sub(lambda cell: with_limit(cell[0], photons), source[0])
        if name != OF_PRIORS:
            source[0] = CELL.sub(lambda cell: with_short_scenes(app, cell[0]), source[0])


def with_short_scenes(app: Any, cell: str) -> str:
    """A cell that simulates the short scenes, which lie in files beside the pages, or writes one as short."""
    for name in SHORT:
        before = "|".join(SIMULATED)
        cell = re.sub(rf"({before}){name}\b", rf"\g<1>{short_scene(app, name)}", cell, flags=re.M)
    return FINGER_WRITTEN.sub(r"\g<0>\n[priors]\nspread = false\n", cell)


def short_scene(app: Any, name: str) -> Path:
    """The file of a short scene."""
    return Path(app.outdir).resolve().parent / "short" / f"{name}.toml"


def write_short_scenes(app: Any) -> None:
    """Before the pages are read: files of the short scenes."""
    for name, changes in SHORT.items() if QUICK else ():
        short_scene(app, name).parent.mkdir(parents=True, exist_ok=True)
        short_scene(app, name).write_text(nailoptics.to_toml(nailoptics.scene(name).with_(changes)), encoding="utf-8")


def with_limit(cell: str, photons: int) -> str:
    """A cell that traces so many photons, whatever limits it has."""
    cell = LIMIT_IN_PYTHON.sub(rf"photons\g<1>{photons}", cell)
    return TRACING.sub(lambda command: f"{LIMIT.sub('', command[1])} --photons {photons}", cell)


def prepare_kernels(app: Any) -> None:
    """Kernels have the look of the pages' figures, and nothing of the user's own settings."""
    profile = Path(app.outdir).resolve().parent / "ipython" / "profile_default"
    profile.mkdir(parents=True, exist_ok=True)
    look = {"figure.dpi": 144, "figure.figsize": [6.4, 3.6], "figure.facecolor": "white", "grid.color": style.GRID}
    lines = [f"c.InlineBackend.rc = {look}", "c.IPKernelApp.log_level = 40"]
    (profile / "ipython_kernel_config.py").write_text("\n".join(lines), encoding="utf-8")
    # What a command prints arrives in pieces, between which myst-nb would break lines.
    NotebookClient.coalesce_streams = True
    NotebookClient.shutdown_kernel = "immediate"  # what a kernel does as it ends is of no use
    os.environ.pop("MPLBACKEND", None)  # figures are shown below the cells that make them
    # What is installed beside Sphinx is run, in lines as wide as the page.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    os.environ |= {
        "COLUMNS": "110",
        "IPYTHONDIR": str(profile.parent),
        "MATPLOTLIBRC": str(Path(style.__file__).with_name("figures.mplstyle")),
        "PATH": path,
    }


def package_digest() -> str:
    """A digest of all that decides what a notebook shows."""
    folders = Path(nailoptics.__file__).parent, data_dir("assets"), data_dir("scenes")
    files = sorted(path for folder in folders for path in folder.rglob("*") if path.suffix in (".py", ".toml", ".csv"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


# Downloads


def executed(app: Any, page: str) -> Path | None:
    """The notebook that a page became when it was run."""
    path = Path(app.outdir).parent / "jupyter_execute" / f"{page}.ipynb"
    return path if path.exists() else None


def offer_download(app: Any, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Below a page's heading: a link to the page as a notebook."""
    if doctree is not None and executed(app, page):
        path = context["pathto"](f"_downloads/{page}.ipynb", 1)
        link = f'<a href="{path}" download>Download this page as a notebook</a>'
        context["body"] = context["body"].replace("</h1>", f'</h1>\n<p class="download">{link}</p>', 1)


def write_downloads(app: Any, failure: Exception | None) -> None:
    """Notebooks with their outputs; of links to other pages the words stay."""
    for page in [] if failure else app.env.found_docs:
        if path := executed(app, page):
            notebook = json.loads(path.read_text(encoding="utf-8"))
            for cell in notebook["cells"]:
                if cell["cell_type"] == "markdown":
                    text = re.sub(r"(?<!!)\[([^\]]+)\]\((?!http)[^)]*\)", r"\1", "".join(cell["source"]))
                    cell["source"] = text
            target = Path(app.outdir) / "_downloads" / f"{page}.ipynb"
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(json.dumps(notebook, indent=1), encoding="utf-8")


def wrap_outputs(app: Any, doctree: nodes.document, page: str) -> None:
    """Sentences that a cell printed end where the page does; tables stay whole, and scroll."""
    for output in doctree.findall(lambda node: "cell_output" in node.get("classes", ()) if node.children else False):
        for block in output.findall(nodes.literal_block):
            text = "\n".join(line if "  " in line.strip() else WRAP.fill(line) for line in block.astext().split("\n"))
            block.children, block.rawsource = [], text
            block += nodes.Text(text)


# Thumbnails


class thumbnails(nodes.General, nodes.Element):
    """Where the thumbnails of some pages are to be."""


class Thumbnails(SphinxDirective):
    """Each page that it names, one a line, by the last picture in it, its heading and its first sentence.

    With `:toctree:` the pages are in the table of contents below the present one, too.
    """

    has_content = True
    option_spec = {"toctree": directives.flag}

    def run(self) -> list[nodes.Node]:
        folder = Path(self.env.docname).parent
        pages = [(folder / line).as_posix() for line in self.content]
        for page in pages:
            self.env.note_dependency(self.env.doc2path(page))
        listed = "\n".join(["```{toctree}", ":hidden:", "", *self.content, "```"]) if "toctree" in self.options else ""
        return [thumbnails(pages=pages), *self.parse_text_to_nodes(listed)]


def fill_thumbnails(app: Any, doctree: nodes.document, page: str) -> None:
    """Replace the marks of the directive by links with pictures."""
    for mark in list(doctree.findall(thumbnails)):
        cards = nodes.container(classes=["thumbnails"])
        cards += [card(app, page, target) for target in mark["pages"]]
        mark.replace_self(cards)


def card(app: Any, page: str, target: str) -> nodes.Node:
    """A picture with a heading and a sentence, which links to its page."""
    shown = app.env.get_doctree(target)
    link = nodes.reference(refuri=app.builder.get_relative_uri(page, target), internal=True)
    for picture in list(shown.findall(nodes.image))[-1:]:
        link += nodes.image(uri=picture["uri"], candidates=picture["candidates"], alt="")
    link += nodes.strong(text=app.env.titles[target].astext())
    card = nodes.container(classes=["card"])
    first = next(iter(shown.findall(nodes.paragraph))).astext()
    card += [
        nodes.paragraph("", "", link),
        nodes.paragraph(text=re.match(r".*?[.?](?=\s|$)|.*", first, re.S)[0].rstrip(":")),
    ]
    return card


def setup(app: Any) -> None:
    """Register the directive, and what is done as pages are read, written and finished."""
    prepare_kernels(app)
    # Pages are run anew where the package is another one.
    app.add_config_value("package_digest", package_digest(), "env")
    app.add_directive("thumbnails", Thumbnails)
    app.add_node(thumbnails)
    app.connect("builder-inited", write_short_scenes)
    app.connect("source-read", with_few_photons)
    app.connect("doctree-resolved", wrap_outputs)
    app.connect("doctree-resolved", fill_thumbnails)
    app.connect("html-page-context", offer_download)
    app.connect("build-finished", write_downloads)
