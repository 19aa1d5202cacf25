"""Sphinx configuration for `make docs`, which treats warnings as errors."""

import mobilecal_cli

project = "mobilecal"
author = "the mobilecal developers"
copyright = author
release = version = mobilecal_cli.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "generate"]
root_doc = "index"

myst_enable_extensions = ["colon_fence", "fieldlist"]
myst_heading_anchors = 3
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
autodoc_typehints = "description"
autodoc_member_order = "bysource"

html_theme = "furo"
html_title = f"mobilecal {release}"
html_copy_source = False
