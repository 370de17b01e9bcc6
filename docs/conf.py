"""Settings of the documentation site, which `make docs` builds into build/site.

The source folder is the repository (`sphinx-build -c docs . build/site`), so that one relative
link works both on a repository page and in the site.
"""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import lf_flame  # noqa: E402 - found by the line above

project = "lf_flame"
author = copyright = "The lf_flame developers"
release = lf_flame.__version__
html_title = f"lf_flame {release}"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
    "site_extension",
]
root_doc = "docs/index"
include_patterns = [
    "docs/**",
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "SECURITY.md",
    "data_gen/README.md",
    "tests/README.md",
    "experiments/*.md",
    "experiments/results/**/*.md",
]
exclude_patterns = [
    *(".*", "build", "data", "runs", "results", "lf_flame"),
    *("docs/tutorials", "docs/generated/tutorials/**/*.md5", "docs/generated/**/*.ipynb"),
    "docs/generated/tutorials/sg_execution_times.rst",
]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
# Reports of experiments begin at a third heading, because tables.md puts several below each other.
suppress_warnings = ["myst.header"]

# `name` in a docstring is a link where it is a public name, and code everywhere else.
default_role = "py:obj"
autodoc_typehints = "none"  # the docstrings name the types, with shapes
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_show_inherited_class_members = False

sphinx_gallery_conf = {
    "examples_dirs": "docs/tutorials",
    "gallery_dirs": "docs/generated/tutorials",
    "filename_pattern": r"\.py$",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "show_memory": False,
    "min_reported_time": 20,
    "write_computation_times": False,
    "within_subsection_order": "FileNameSortKey",
    "remove_config_comments": True,
    "plot_gallery": True,
}

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_extra_path = ["static/root"]  # index.html, which leads to docs/index.html
html_copy_source = False
html_search_scorer = str(HERE / "static" / "search_order.js")
html_theme_options = {"navigation_with_keys": True}
