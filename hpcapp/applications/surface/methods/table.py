"""The table of methods: a new one is a folder with its settings, and a line here."""

from __future__ import annotations

from importlib import import_module

from hpcapp.applications.surface.methods.method import MethodSettings
from hpccomponent.errors import UsageError

METHODS = {
    "hierarchical": "hpcapp.applications.surface.hierarchical.settings:Hierarchical",
    "paper": "hpcapp.applications.surface.paper.settings:Paper",
}
DEFAULT_METHOD = "hierarchical"


def find_method(name: str) -> type[MethodSettings]:
    """Return the settings of a method by its key in `METHODS`; UsageError where there is none."""
    if name not in METHODS:
        raise UsageError(f"unknown method {name!r}", f"choose {' or '.join(METHODS)}")
    module, _, attribute = METHODS[name].partition(":")
    found: type[MethodSettings] = getattr(import_module(module), attribute)
    return found
