"""A Sphinx extension that writes equations as MathML, which browsers display without scripts or the network."""

import re
from html import escape

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number

log = logging.getLogger(__name__)
# a function name and its argument, between which MathML leaves no space
NAME = re.compile(r"(<mi>(?:arc)?(?:cos|sin|tan)</mi>)(\s*<m(?:i|n|frac|sub|sup)\b)")


def translate(node, *, as_block=False):
    """Return the MathML of an equation. If it cannot be converted, issue a warning and return the source."""
    try:
        return NAME.sub(r"\1<mspace width='0.17em'/>\2", tex2mathml(node.astext(), as_block=as_block))
    except MathError as error:
        log.warning("%s", error, location=node)
        return escape(node.astext())


def visit_math(self, node):
    """Write an equation in a line of text."""
    self.body.append(translate(node))
    raise nodes.SkipNode


def visit_displaymath(self, node):
    """Write a displayed equation, with its number if it has a label."""
    self.body.append(self.starttag(node, "div", CLASS="math"))
    if node["number"]:
        self.body.append(f'<span class="eqno">({get_node_equation_number(self, node)})')
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append(translate(node, as_block=True))
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app):
    """Connect the functions to Sphinx."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_displaymath, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
