"""How Sphinx builds the documentation: `sphinx-build -W docs build/docs`. Nothing is fetched, here or by the pages.

Code of the pages is run, and its output shown, as notebooks.py says.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import formulas  # noqa: E402
import generated  # noqa: E402
import notebooks  # noqa: E402

import nailoptics  # noqa: E402

project = "nailoptics"
author = "the nailoptics developers"
copyright = author  # noqa: A001
version = release = nailoptics.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc"]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_default_options = {"exclude-members": "model_config"}
add_module_names = False

nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 1800
nb_execution_show_tb = True
nb_output_stderr = "remove"  # progress
nb_merge_streams = True

exclude_patterns = ["build"]

highlight_language = "none"  # blocks without a language are shell commands
smartquotes_action = "qe"  # -- begins an option
html_theme = "furo"
html_title = f"nailoptics {release}"
html_static_path = ["static"]
html_css_files = ["docs.css"]
html_math_renderer = "matplotlib"
html_copy_source = False


def setup(app: object) -> None:
    """Insert the generated text, and typeset formulas without a network."""
    app.connect("source-read", generated.fill_in)
    app.connect("autodoc-process-docstring", generated.as_markup)
    formulas.setup(app)
    notebooks.setup(app)
