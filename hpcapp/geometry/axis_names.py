"""The axes that may point up; without numpy, as every ``--help`` names them."""

from __future__ import annotations

AXES = ("z", "y", "x", "-z", "-y", "-x")
"""What may point up."""
