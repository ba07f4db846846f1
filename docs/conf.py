"""Sphinx settings of the documentation site: `make docs` builds it into site/, without the internet."""

from __future__ import annotations

import os
import sys
from importlib.metadata import version as version_of
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS.parent), str(DOCS / "_extensions")]
# Tutorials call `coilcal` as a reader would: the one of the environment that builds the site.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
os.environ["PYTHONPATH"] = os.pathsep.join([*sys.path[:2], os.environ.get("PYTHONPATH", "")]).rstrip(
    os.pathsep
)
os.environ.setdefault("OMP_NUM_THREADS", "1")

project = "coilcal"
author = "coilcal developers"
copyright = author  # the name that Sphinx asks for
release = version = version_of("coilcal")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_click",
    "sphinx_copybutton",
    "mathml",
    "plain_words",
    "terminal_cells",
]
exclude_patterns = ["figures"]
source_suffix = {".md": "myst-nb"}

# Markdown as GitHub shows it, so that pages read well in both places.
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

# A cache would keep what an older estimator printed, so every build runs every tutorial; COILCAL_DOCS_RUN=off for drafts.
nb_execution_mode = os.environ.get("COILCAL_DOCS_RUN", "force")
suppress_warnings = (
    [] if nb_execution_mode == "force" else ["myst-nb.lexer"]
)  # a draft knows no language of its cells
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 1200
nb_execution_show_tb = True
nb_merge_streams = True

default_role = "code"  # what docstrings put between single backticks
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
toc_object_entries = False

copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True

html_theme = "pydata_sphinx_theme"
html_title = f"coilcal {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_sidebars = {"index": [], "results": []}
html_theme_options = {
    "logo": {"text": "coilcal"},
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "navigation_with_keys": False,
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
