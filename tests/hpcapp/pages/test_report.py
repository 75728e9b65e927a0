"""Reports that anybody may have written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hpcapp.pages.job import describe_job
from hpcapp.pages.report import check_report, read_report
from hpcapp.pages.templates import render
from hpccomponent.errors import InputError

SPAN: dict[str, object] = {"name": "fit", "worker": "w", "begin": 0.0, "end": 1.0}


def nested(depth: int) -> object:
    value: object = 1
    for _ in range(depth):
        value = {"a": [value]}
    return value


@pytest.mark.parametrize(
    "report",
    [
        {"summary": 7},
        {"warnings": "many"},
        {"warnings": [{}]},
        {"command": [1]},
        {"stages": [1.0]},
        {"stages": {"fit": "long"}},
        {"stages": {"fit": -1.0}},
        {"stages": {"fit": 1e400}},
        {"stages": {"fit": 10**400}},
        {"timeline": []},
        {"timeline": {"spans": SPAN}},
        {"timeline": {"spans": [SPAN | {"end": 1e400}]}},
        {"timeline": {"spans": [SPAN | {"end": None}]}},
        {"timeline": {"spans": [SPAN | {"begin": -1.0}]}},
        {"timeline": {"spans": [{"name": "fit"}]}},
        {"spacing": "0.1"},
        {"spacing": -1.0},
        {"anything": nested(400)},
    ],
)
def test_a_report_that_no_job_writes_is_refused(tmp_path: Path, report: dict[str, object]) -> None:
    (tmp_path / "r.json").write_text(json.dumps(report).replace("Infinity", "1e400"))
    with pytest.raises(InputError, match=r"r\.json: is no report of a job") as caught:
        read_report(tmp_path / "r.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "[]", "{", '{"a": NaN}', '{"a":' * 100_000])
def test_what_is_no_json_object_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(InputError, match=r"r\.json: is no report"):
        read_report(tmp_path / "r.json")
    with pytest.raises(InputError, match="Is a directory"):
        read_report(tmp_path)


def test_a_command_to_copy_hides_nothing() -> None:
    sections = describe_job({"command": ["hpcapp", "\x1b[8m", "a\u202eb"], "stages": None,
                             "timeline": None, "warnings": None})  # fmt: skip
    text = "".join(render(one.template, body=one.values) for one in sections)
    assert not set("\x1b\u202e") & set(text)


def test_what_is_new_in_a_report_is_said() -> None:
    report: dict[str, object] = {
        "later": {"deep": [1, {"x": None}]},
        "big": 10**300,
        "timeline": {"spans": [SPAN | {"name": f"task-{number}"} for number in range(5000)]},
    }
    check_report(report, "r.json")
    sections = describe_job(report)
    text = "".join(render(one.template, body=one.values) for one in sections)
    assert "deep 1, x -" in text
    assert text.count("<tr>") < 100  # however many names there are
