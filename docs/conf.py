# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Sphinx configuration of the site for `make docs` and rosdoc2; writes generated pages first."""

from importlib.util import find_spec
from pathlib import Path
import sys

from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
# The built package, with compiled kernels; otherwise the sources.
sys.path[:0] = [str(HERE / 'tools'), *([] if find_spec('hnn_vi_ros') else [str(HERE.parent)])]

import generate  # noqa: E402, I100  in tools/
from hnn_vi_ros.version import __version__  # noqa: E402
import redirects  # noqa: E402

project, author = 'hnn_vi_ros', 'The hnn_vi_ros Authors'
copyright = f'2026 {author}'  # noqa: A001  Sphinx calls it so
version = release = __version__
extensions = ['myst_nb', 'sphinx.ext.autodoc', 'numpydoc']
exclude_patterns = ['_build', 'benchmarks', 'studies']
# Notebooks are executed where they leave nothing behind, and again when they have changed.
nb_execution_mode, nb_execution_in_temp, nb_execution_timeout = 'cache', True, 600
nb_execution_raise_on_error, nb_merge_streams = True, True
# Sections of one page are linked by their headings, as on GitHub.
myst_heading_anchors = 4
myst_enable_extensions = ['attrs_block', 'colon_fence', 'deflist', 'dollarmath']
numpydoc_show_class_members = False
autodoc_typehints = 'none'
# Extras, used only by their own section of the Python API.
autodoc_mock_imports = [name for name in ('gymnasium', 'torch') if find_spec(name) is None]
add_module_names = False
pygments_style, pygments_dark_style = 'default', 'github-dark'

html_theme = 'furo'
html_title = f'hnn_vi_ros {release}'
# Pages of their own, which others embed.
html_static_path = ['_static', 'evidence/accuracy/explore.html']
html_css_files = ['site.css']
html_theme_options = {'top_of_page_buttons': ['view']}
html_copy_source = False


def setup(app: Sphinx) -> None:
    """Write the generated pages before Sphinx looks for its sources, and redirects at its end."""
    app.connect('config-inited', lambda app, config: generate.write_pages(HERE))
    app.connect('build-finished', lambda app, error: redirects.write(Path(app.outdir)))
