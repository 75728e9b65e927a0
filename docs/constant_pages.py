"""Makes the table of the default method's constants, whose values are read from the code."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module

PACKAGE = "hpcapp.applications.surface"
CONSTANTS = (
    ("scale", "resolution.estimates:_SPACINGS", "spacings across a cell"),
    ("scale", "resolution.estimates:_NOISE_CELLS", "standard deviations of the noise across one"),
    ("scale", "resolution.estimates:_FEWEST", "local spacings across a leaf, to twice as many"),
    ("scale", "resolution.estimates:_MOST_LEVELS", "times that cells are halved, or doubled"),
    ("noise", "resolution.estimates:_FREE", "coefficients of a quadric"),
    ("noise", "field.weights:SAME_NOISE", "times the variance, that is the same noise"),
    ("noise", "field.weights:_BIAS_GROWTH", "what of the rest is missed detail"),
    ("noise", "field.local_noise:SHARE", "deviations across a cell, at most, that it tells"),
    ("noise", "field.local_noise:QUARTILE", "quantile of a pool's variances that counts"),
    ("noise", "field.local_noise:_FEWEST", "vertices of a pool"),
    ("noise", "field.local_noise:_UNTOLD", "spacings: what relief leaves, too"),
    ("noise", "field.weights:_LEAST_LOCAL", "of the cloud's variance, at least, at a vertex"),
    ("noise", "field.weights:_MOST_LOCAL", "and at most"),
    ("fit", "field.weights:_LAM_PER_NOISE", "weight λ of the normals, by (noise / cell)²"),
    ("fit", "field.weights:_LEAST_LAM", "λ at least"),
    ("fit", "field.weights:_LEAST_COARSE_LAM", "λ at least, on coarser levels"),
    ("fit", "field.weights:_MOST_LAM", "λ at most"),
    ("fit", "field.weights:LEAST_MU", "weight μ of the prior at least, in points"),
    ("fit", "field.weights:_MOST_MU", "μ at most"),
    ("fit", "field.weights:BELIEVED", "of noise up to half a spacing, what fits reckon with"),
    ("fit", "field.weights:CHANCE_SHARE", "of the variance, what excuses a prior"),
    ("blend", "field.weights:FIELD_LEVELS", "levels that are blended, from the base up"),
    ("blend", "field.weights:_FULL_COUNT", "own points of full trust"),
    ("blend", "field.weights:_FULL_INHERITED", "inherited points of full trust"),
    ("blend", "field.weights:_CROWDED_FROM", "others in a finer cell, from which trust falls"),
    ("blend", "field.weights:_CROWDED_AT", "and at which it is gone"),
    ("blend", "field.weights:_AGREES", "misfit of normals, from which trust falls"),
    ("blend", "field.weights:_CONTRADICTS", "and at which it is gone"),
    ("far field", "field.far_field:FEWEST_NODES", "nodes along a side"),
    ("far field", "hierarchical.coarse:_MOST_NODES", "likewise, of folds and thin walls"),
    ("far field", "field.far_field:FAR_REACH", "steps at which the distance is cut off"),
    ("far field", "field.weights:_OVERRULED_FROM", "steps from which it overrules empty quadrics"),
    ("far field", "field.weights:_OVERRULED_AT", "and at which it has done so"),
    ("hull", "field.hull:_BARE", "length of the mean normal from which a side is missing"),
    ("hull", "field.hull:_OPPOSED", "least cosine of a facet's normal to those of its corners"),
    ("hull", "field.hull:_MARGIN", "cells that the surface may go beyond a facet"),
    ("heavy tails", "field.robust:_GAUSSIAN", "kurtosis from which points are weighed"),
    ("sharp", "field.features:_ROUND", "misfit of normals from which edges are looked for"),
    ("sharp", "field.features:_REACH", "cells around a vertex that are looked at"),
    ("handles", "stitching.handles:BOX", "sides of faces, into which a small one fits"),
    ("open", "boundary.drive:_FILL", "trim distances: holes that are filled"),
    ("open", "boundary.drive:_CRUMB", "likewise: pieces that are dropped"),
    ("open", "boundary.closing:SURE", "probability from which nothing is said"),
)
"""Stage, place in the code, and meaning of each constant that the page names."""


def describe_constants() -> Iterator[str]:
    """Yield the table; a constant that the code has no more is an AttributeError."""
    yield "| stage | constant | value | meaning |\n|---|---|---|---|"
    for stage, place, meaning in CONSTANTS:
        module, _, name = place.partition(":")
        value = getattr(import_module(f"{PACKAGE}.{module}"), name)
        yield f"| {stage} | `{module}.{name.strip('_')}` | {value:g} | {meaning} |"
