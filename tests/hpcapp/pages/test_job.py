"""A job's report as a page says it."""

from __future__ import annotations

from hpcapp.pages.job import describe_job
from hpcapp.pages.report import TaskSpan
from hpcapp.pages.templates import render
from hpcapp.pages.timeline import draw_timeline

REPORT: dict[str, object] = {
    "summary": "4 vertices",
    "method": "hierarchical",
    "vertices": 4,
    "watertight": True,
    "spacing": 0.25,
    "noise": 0.001,
    "levels": 5,
    "lam": 0.001,
    "components": 1234,
    "support": {"share": 0.98349, "farthest": 1.26, "reach": 0.75},
    "a_new_fact": 17,
    "normals": {"source": "estimated", "sure": 0.75},
    "dropped": {"outliers": 12},
    "warnings": ["the <scan> is open"],
    "input": {
        "files": ["a.las"],
        "format": "LAS",
        "unit": "m",
        "columns": {"X": "position", "t": "left out"},
    },
    "backend": "zmq",
    "workers": 2,
    "choice": {"reason": "it was asked for"},
    "bytes_sent": 123456,
    "stages": {"read": 1.5, "fit": 0.5},
    "command": ["hpcapp", "reconstruct", "my scan.las", "-o", "m.ply"],
}


def bodies(report: dict[str, object], marked: tuple[str, ...] = ()) -> dict[str, str]:
    return {
        section.title: render(section.template, body=section.values)
        for section in describe_job(report, marked)
    }


def drawing(spans: list[TaskSpan]) -> str:
    return render("timeline.html", body=draw_timeline(spans))


def test_everything_that_was_decided_is_said() -> None:
    decided = bodies(REPORT)["Decided"]
    for words in ("hierarchical", "0.25", "0.001", "a new fact", "17", "estimated", "75.0 %", "12"):
        assert words in decided


def test_columns_are_said_by_their_use() -> None:
    said = bodies(REPORT)["Input"]
    assert "taken as position" in said
    assert "taken as left out" in said


def test_warnings_that_are_marked_come_first() -> None:
    said = bodies(REPORT, ("a hole",))["Warnings"]
    assert said.index("a hole") < said.index("the &lt;scan&gt; is open")
    assert said.count("data-marker") == 1


def test_the_command_can_be_typed_again() -> None:
    assert "reconstruct &#39;my scan.las&#39; -o m.ply" in bodies(REPORT)["To do it again"]


def test_traffic_failures_and_cost_are_said() -> None:
    spans = [
        {"name": "mesh_tile", "worker": "w-1", "begin": 0.0, "end": 1.0, "outcome": "lost"},
        {"name": "mesh_tile", "worker": "w-2", "begin": 1.0, "end": 2.0, "outcome": "done"},
    ]
    told = {**REPORT, "timeline": {"spans": spans}, "cost": "0.12 USD"}
    said = bodies(told)["Workers and traffic"]
    assert "123,456" in said
    assert "it was asked for" in said
    assert "0.12 USD" in said
    assert '<th>tasks lost</th><td class="number">1</td>' in said
    assert "w-1" in bodies(told)["Time"]


def test_an_empty_report_has_no_empty_tables() -> None:
    assert all("<tr>" in body or title == "Warnings" or "<table>" in body
               for title, body in bodies({"summary": ""}).items())  # fmt: skip


def test_stages_stand_in_for_spans() -> None:
    said = bodies(REPORT)["Time"]
    assert "read: 1.50 s from 0 s" in said
    assert "fit: 0.500 s from 1.50 s" in said


def test_workers_are_in_the_order_of_their_numbers_behind_the_master() -> None:
    spans = [TaskSpan("t", worker, 0.0, 1.0) for worker in ("w-10", "w-2", "master")]
    drawn = drawing(spans)
    assert drawn.index(">master<") < drawn.index(">w-2<") < drawn.index(">w-10<")


def test_of_very_many_spans_the_longest_are_drawn() -> None:
    spans = [TaskSpan("t", f"w-{n % 100}", 0.0, 1.0 + n) for n in range(5000)]
    drawn = drawing(spans)
    assert drawn.count("<title>") <= 4000
    assert "the longest 4,000 of 5,000 spans and 64 of 100 workers" in drawn


def test_nothing_is_drawn_of_nothing() -> None:
    assert draw_timeline([]) == {}


def test_settings_have_readable_names_and_lengths_their_unit() -> None:
    said = bodies(REPORT)
    assert "<th>smoothing</th>" in said["Decided"]
    assert "lam" not in said["Decided"]
    assert "<th>spacing of the points</th><td>0.250 m</td>" in said["Decided"]
    assert '<th>pieces</th><td class="number">1,234</td>' in said["Mesh"]
    assert "<th>supported by points</th><td>98.3 %</td>" in said["Mesh"]
    assert "1.26 m" in said["Mesh"]


def test_times_are_at_round_numbers() -> None:
    drawn = drawing([TaskSpan("t", "w-1", 0.0, 4.7)])
    assert [f">{tick} s<" in drawn for tick in (0, 2, 4, 4.7)] == [True, True, True, False]


def test_what_a_scan_was_read_as_is_said_with_its_rivals_and_reasons() -> None:
    reading = {
        "kind": "above",
        "certainty": 0.75,
        "rivals": [{"kind": "below", "probability": 0.25, "option": "below"}],
        "because": [{"name": "cost", "value": 0.5, "unit": "of the area"}],
    }
    decided = bodies({"reading": reading})["Decided"]
    for said in ("above", "75.0 %", "below, 25.0 %, below", "cost, 0.500, of the area"):
        assert said in decided
