from __future__ import annotations

from result_pages import describe_results

from hpccomponent.runtime.tasks import TaskRegistry


def test_the_page_lists_every_task_of_the_surface_and_the_shape_of_every_array() -> None:
    page = "\n".join(describe_results())
    tasks = {name for name in TaskRegistry().references() if name.startswith("surface.")}
    assert all(f"| `{name}` |" in page for name in tasks)
    assert "ndarray" not in page
    assert "| `offsets` | float32 (n, 3) | 0 to 0.99999994 | blocks | Block after block," in page
