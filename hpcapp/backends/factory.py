"""Any Executor behind the seam: by the name of a function that makes one."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from importlib import import_module

from hpcapp.backends.retrying import RetryingExecutor
from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import UsageError

_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")


def is_factory(name: str) -> bool:
    """Tell whether a backend's name has the form ``module:function``.

    Examples
    --------
    >>> is_factory("loky:get_reusable_executor"), is_factory("tcp://host:1")
    (True, False)
    """
    return _NAME.fullmatch(name) is not None


def find_factory(name: str) -> Callable[..., object]:
    """Import a factory; UsageError where there is no such module or function."""
    module, _, function = name.partition(":")
    try:
        factory = getattr(import_module(module), function)
    except AttributeError:
        raise UsageError(
            f"backend {name}: the module {module} has no {function}", "correct the name"
        ) from None
    except Exception as error:
        raise UsageError(
            f"backend {name}: {module} cannot be imported ({type(error).__name__}: {error})",
            "install it, or add its folder to PYTHONPATH",
        ) from error
    if not callable(factory):
        raise UsageError(f"backend {name}: it is {factory!r}, not a function", "name a function")
    return factory  # type: ignore[no-any-return]


@contextmanager
def open_factory(name: str, workers: int | None) -> Iterator[RetryingExecutor]:
    """Use the Executor that a factory makes; when it is broken, the factory is called again.

    `workers` is passed on as ``workers=``; without it the factory is called with nothing. Raise
    UsageError where the factory is not one.
    """
    factory = find_factory(name)
    arguments = {} if workers is None else {"workers": workers}
    _check_arguments(name, factory, arguments)

    @contextmanager
    def open_made() -> Iterator[Executor]:
        made = _make(name, factory, arguments)
        try:
            yield made
        finally:
            made.shutdown(wait=True)

    executor = RetryingExecutor(open_made, workers)
    try:
        yield executor
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def _check_arguments(name: str, factory: Callable[..., object], arguments: dict[str, int]) -> None:
    """Refuse a factory that cannot be called so, before it runs."""
    try:
        signature = inspect.signature(factory)
    except (TypeError, ValueError):  # some functions of C do not tell
        return
    try:
        signature.bind(**arguments)
    except TypeError as error:
        called = f"with workers={arguments['workers']}" if arguments else "without arguments"
        advice = f"leave {name_option('workers')} out, or name a function that takes workers=N"
        raise UsageError(
            f"backend {name} cannot be called {called}: {error}",
            advice if arguments else "name a function that makes an Executor of nothing",
        ) from None


def _make(name: str, factory: Callable[..., object], arguments: dict[str, int]) -> Executor:
    try:
        made = factory(**arguments)
    except Exception as error:
        raise UsageError(
            f"backend {name} failed ({type(error).__name__}: {error})",
            f"mend it, or choose another {name_option('backend')}",
        ) from error
    if not isinstance(made, Executor):
        raise UsageError(
            f"backend {name} made a {type(made).__name__}, not a concurrent.futures.Executor",
            "return an Executor",
        )
    return made
