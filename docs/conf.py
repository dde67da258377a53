"""How Sphinx builds the book, which `make reports` writes to reports/."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

import trustlab  # noqa: E402

project = "trustlab"
author = "The trustlab developers"
release = trustlab.__version__
copyright = author
language = "en"

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "extension",
]
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_heading_slug_func = "extension.slug"
# `make reports` has run the notebooks.
nb_execution_mode = "off"
nb_render_markdown_format = "myst"
nb_merge_streams = True
nb_code_prompt_show = "Code"
nb_code_prompt_hide = "Code"
nb_ipywidgets_js = {}
numfig = True
numfig_format = {"figure": "Figure %s", "table": "Table %s"}
# In notebooks the levels of headings are those of their outputs, too.
suppress_warnings = ["myst.header", "myst-nb.ipykernel"]
default_role = "known_name"

autosummary_generate = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
html_math_renderer = "mathml"

html_theme = "pydata_sphinx_theme"
html_title = f"trustlab {release}"
html_static_path = ["static"]
html_css_files = ["dt_bundle.css", "own.css"]
html_js_files = ["dt_bundle.js", "tables.js"]
html_copy_source = False
# The excerpts below the results of a search are fetched, which a browser refuses for pages opened
# from a disk.
html_show_search_summary = False
# Pages that stand alone have nothing beside them to list.
ALONE = ("index", "start", "install", "finder", "benchmarks", "search", "genindex")
html_sidebars = {page: [] for page in ALONE}
exclude_patterns = ["**/.ipynb_checkpoints"]
# A chapter whose data are not here is not in the book; real_sessions.md says what it shows.
chapters = Path(__file__).parent.glob("*.ipynb")
exclude_patterns += [path.name for path in chapters if "**Skipped: " in path.read_text("utf-8")]
html_context = {"default_mode": "auto"}
html_theme_options = {
    "navbar_end": ["theme-switcher"],
    "show_nav_level": 1,
    # What unfolds the other branches has no name that a screen reader could say.
    "collapse_navigation": True,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}
