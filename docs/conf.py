"""Sphinx's settings for the documentation; `./run docs` builds it into out/docs."""

import sys
from pathlib import Path

import viscovib

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_extensions"))

import scene_keys  # noqa: E402

project = "viscovib"
author = "The viscovib developers"
project_copyright = author
version = release = viscovib.__version__

extensions = [
    "mathml",
    "myst_parser",
    "notebooks",
    "plain_docstrings",
    "run_blocks",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_*", "ford.md", "paper.md", "examples/short", "**/sg_execution_times.rst"]
templates_path = ["_templates"]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "substitution"]
# The tables of keys on the page of scenes come from the table that the reader uses.
myst_substitutions = scene_keys.tables()
myst_heading_anchors = 4

# Every name has a page of its own, made from its docstring.
autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

sphinx_gallery_conf = {
    "examples_dirs": "examples/short",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "image_scrapers": ("matplotlib",),
    # Pages show figures and printed output, not the value of the last line.
    "capture_repr": (),
    "matplotlib_animations": False,
    "plot_gallery": True,
    "write_computation_times": False,
}

# Quotes of keys and calls remain typewriter quotes.
smartquotes = False
maximum_signature_line_length = 90

html_theme = "furo"
html_title = f"viscovib {release}"
html_show_sourcelink = False
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["viscovib.css"]
# No page may need the network.
# Attributes of several results share a name; a docstring means those of its own class.
suppress_warnings = ["config.cache", "ref.python"]
