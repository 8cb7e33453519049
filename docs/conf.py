"""Settings of Sphinx for `make site`."""

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from firmware_py import __version__
from metro_tools.site import SCRIPT

project = "Metro VOBC bench"
html_show_copyright = False
version = release = __version__
extensions = ["myst_parser"]
html_theme = "furo"
html_title = f"{project} {__version__}"
html_static_path = [str(SCRIPT.parent)]
html_copy_source = False
html_show_sphinx = False
html_use_index = False
html_js_files = ["mermaid.min.js"]
html_theme_options = {"navigation_with_keys": True}
templates_path: list[str] = []
myst_heading_anchors = 6
myst_fence_as_directive = ["mermaid"]
myst_all_links_external = False
exclude_patterns = ["examples/*/runs"]
suppress_warnings = ["misc.highlighting_failure"]


class MermaidChart(SphinxDirective):
    """A chart that the library in the page draws."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """As a block that the library looks for."""
        text = nodes.Text("\n".join(self.content)).astext()
        safe = text.replace("&", "&amp;").replace("<", "&lt;")
        return [nodes.raw("", f'<pre class="mermaid">\n{safe}\n</pre>', format="html")]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the chart."""
    app.add_directive("mermaid", MermaidChart)
    return {"parallel_read_safe": True}
