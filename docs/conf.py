"""The site of the documents: `make docs` builds it."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import harvesters.core  # noqa: F401 - its import makes all warnings visible

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent))

import sgp  # noqa: E402 - from this checkout

# The packages of Sphinx use names of each other that a later version will not have.
warnings.simplefilter("ignore", PendingDeprecationWarning)

project = "Surface Geometry Processing"
release = sgp.__version__
version = release

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "docs._extensions.generated_parts",
    "docs._extensions.reference_pages",
]
exclude_patterns = ["_build", "_extensions", "gallery"]
suppress_warnings = ["config.cache"]  # the settings of the gallery contain functions

# Names in single backticks link to what they name, if the site has it.
default_role = "py:obj"
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]

autodoc_typehints = "none"
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_attr_annotations = False
python_use_unqualified_type_names = True

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "generated/gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "reset_modules": ("matplotlib",),
    "abort_on_example_error": True,
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "remove_config_comments": True,
    "write_computation_times": False,
}

html_theme = "pydata_sphinx_theme"
html_title = project
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # browsers fetch no page of a local folder
html_context = {"default_mode": "auto"}
html_theme_options = {
    "logo": {"text": "sgp"},
    "navbar_align": "left",
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": [],
    "footer_end": [],
}
