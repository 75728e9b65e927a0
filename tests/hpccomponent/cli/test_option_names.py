from __future__ import annotations

import threading

from hpccomponent.cli.option_names import name_option, speaking_flags


def test_python_is_spoken_unless_the_command_says_otherwise() -> None:
    assert name_option("max_memory") == "max_memory"
    with speaking_flags():
        assert name_option("max_memory", "2G") == "--max-memory 2G"
    assert name_option("max_memory", "2G") == "max_memory='2G'"


def test_options_that_python_calls_otherwise_have_its_names() -> None:
    assert name_option("backend", "zmq") == "executor='zmq'"
    assert name_option("viewpoint") == "viewpoints"


def test_threads_speak_as_their_process_does() -> None:
    heard: list[str] = []
    with speaking_flags():
        thread = threading.Thread(target=lambda: heard.append(name_option("grid", 64)))
        thread.start()
        thread.join()
    assert heard == ["--grid 64"]
