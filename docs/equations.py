"""Equations as MathML, which browsers draw themselves: the site needs no script of another host."""

from __future__ import annotations

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator


def add_renderer(app: Sphinx) -> None:
    """Register the renderer ``mathml``, for `html_math_renderer`."""
    app.add_html_math_renderer("mathml", (_write_inline, None), (_write_block, None))


def _write_inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(_to_mathml(node.astext(), is_block=False))
    raise nodes.SkipNode


def _write_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    mathml = _to_mathml(node.astext(), is_block=True)
    translator.body.append(f'<div class="math">{mathml}</div>')
    raise nodes.SkipNode


def _to_mathml(tex: str, *, is_block: bool) -> str:
    found: str = latex2mathml.tex2mathml(tex, as_block=is_block)
    return found
