"""`dataclass` of the standard library, without its compiler.

The standard one writes the source of some six methods for each class and compiles it at import:
.45 ms a class, an eighth of a whole job of 36 thousand points. Here they are written once and read
the fields of the class that they are called for. `fields`, `replace` and `asdict` of the standard
library take such classes as their own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:
    import dataclasses
    import operator

    def dataclass(*, frozen=False, init=True, repr=True, eq=True, order=False, **rest):  # noqa: A002 - its name there
        """Do what `dataclasses.dataclass` does."""

        def decorate(kind):
            methods = {}
            if init:
                methods |= {"__init__": _init, "__signature__": _Signature()}
            if repr:
                methods |= {"__repr__": _repr}
            if eq:
                methods |= {"__eq__": _EQ, "__hash__": _hash if frozen else None}
            if order:
                methods |= _ORDER
            if frozen:
                methods |= {"__setattr__": _refuse, "__delattr__": _refuse}
                methods |= {"__getstate__": _values, "__setstate__": _restore}
            own = vars(kind)
            for name, method in methods.items():
                if own.get(name) is None:
                    setattr(kind, name, method)
            return dataclasses.dataclass(init=False, repr=False, eq=False, **rest)(kind)

        return decorate

    def _init(self, /, *values, **named):
        put, given = object.__setattr__, iter(values)
        for field in dataclasses.fields(self):
            name = field.name
            if not field.init:
                value = dataclasses.MISSING
            elif field.kw_only or (value := next(given, given)) is given:
                value = named.pop(name, dataclasses.MISSING)
            if value is dataclasses.MISSING:
                value = field.default
                if field.default_factory is not dataclasses.MISSING:
                    value = field.default_factory()
                elif value is dataclasses.MISSING and field.init:
                    raise TypeError(f"{type(self).__qualname__}() misses the argument {name!r}")
            if value is not dataclasses.MISSING:
                put(self, name, value)
        if named or next(given, given) is not given:
            more = ", ".join(map(repr, named)) or "positional ones"
            raise TypeError(f"{type(self).__qualname__}() takes no such arguments: {more}")
        if hasattr(self, "__post_init__"):
            self.__post_init__()

    class _Signature:
        """What a class is called with, for those who look."""

        def __get__(self, instance, kind):
            from inspect import Parameter, Signature  # takes a while

            def default(field):
                if field.default_factory is not dataclasses.MISSING:
                    return ...
                return Parameter.empty if field.default is dataclasses.MISSING else field.default

            if kind.__init__ is not _init:
                raise AttributeError("__signature__")
            ways = (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
            given = [field for field in dataclasses.fields(kind) if field.init]
            return Signature([
                Parameter(field.name, ways[way], annotation=field.type, default=default(field))
                for way in (False, True) for field in given if field.kw_only is way
            ])  # fmt: skip

    def _values(self):
        return [getattr(self, field.name) for field in dataclasses.fields(self)]

    def _restore(self, state):
        for field, value in zip(dataclasses.fields(self), state, strict=True):
            object.__setattr__(self, field.name, value)

    def _repr(self):
        shown = [field.name for field in dataclasses.fields(self) if field.repr]
        values = ", ".join(f"{name}={getattr(self, name)!r}" for name in shown)
        return f"{type(self).__qualname__}({values})"

    def _compared(self):
        fields = dataclasses.fields(self)
        return tuple(getattr(self, field.name) for field in fields if field.compare)

    def _compare_by(compare):
        def method(self, other):
            if type(other) is not type(self):
                return NotImplemented
            return compare(_compared(self), _compared(other))

        return method

    _EQ = _compare_by(operator.eq)
    _ORDER = {
        f"__{name}__": _compare_by(getattr(operator, name)) for name in ("lt", "le", "gt", "ge")
    }

    def _hash(self):
        return hash(_compared(self))

    def _refuse(self, name, *value):  # noqa: ARG001 - as Python calls it
        raise dataclasses.FrozenInstanceError(f"cannot change {name!r} of a frozen value")
