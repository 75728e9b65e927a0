from __future__ import annotations

import json

from hpcapp.applications.surface.types.reading import UNREAD, Measurement, Reading, Rival


def test_a_reading_is_the_same_after_a_report() -> None:
    reading = Reading(
        "+y-z", 0.75, "y", (0.0, -0.25, 0.5), 0.125,
        (Rival("outside", 0.25, "outside"),), (Measurement("cost", 0.0625, "of the area"),),
    )  # fmt: skip
    for one in (reading, UNREAD):
        assert Reading.of_json(json.loads(json.dumps(one.to_json()))) == one
