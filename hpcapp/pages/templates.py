"""Pages as HTML: one environment of templates, in which whatever is filled in is text.

Nothing else makes HTML or SVG. ``|safe`` stands in templates behind files of this package alone.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from hpcapp.wording import say_number, say_value

if TYPE_CHECKING:
    from jinja2 import Environment


def render(template: str, **values: object) -> str:
    """Return a file of ``templates/`` with values filled in, each of them escaped."""
    return _load().get_template(template).render(values)


@cache
def _load() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("hpcapp.pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    environment.filters |= {"say_number": say_number, "say_value": say_value}
    return environment
