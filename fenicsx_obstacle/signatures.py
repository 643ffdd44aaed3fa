"""Arguments of the public functions, checked against the annotations of these functions."""

from __future__ import annotations

import inspect
import numbers
import types
from collections.abc import Callable, Mapping
from functools import cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import nearest, shown

P = ParamSpec("P")
T = TypeVar("T")
_WORDS = {float: "a number", int: "a whole number", str: "a text", bool: "True or False", Mapping: "a dict",
          Path: "a path"}  # fmt: skip


def checked(**expected: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorator: check the names and types of the arguments of a function.

    Args:
        **expected: What to say is expected, where the annotation of an argument does not say it all.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        signature = inspect.signature(function)
        named = [name for name, one in signature.parameters.items() if one.kind != inspect.Parameter.VAR_KEYWORD]
        name = function.__qualname__
        check_names = _check_names(name, signature)

        @cache
        def kinds() -> dict[str, Any]:
            kept = (signature.parameters[key] for key in named)
            return {one.name: eval(one.annotation, function.__globals__) for one in kept if one.annotation != one.empty}

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> T:
            check_names(args, kwargs)
            given = signature.bind(*args, **kwargs).arguments
            for key, kind in kinds().items():
                if key in given and not _fits(given[key], kind):
                    raise InputError(
                        f"{name}: {key} = {shown(given[key])}: expected {expected.get(key) or _words(kind)}"
                    )
            return function(*args, **kwargs)

        return call

    return decorate


def names_checked(function: Callable[P, T]) -> Callable[P, T]:
    """Decorator: check the names of the arguments of a function, but not their types."""
    check_names = _check_names(function.__qualname__.removesuffix(".__init__"), inspect.signature(function))

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        check_names(args, kwargs)
        return function(*args, **kwargs)

    return call


def _check_names(name: str, signature: inspect.Signature) -> Callable[[tuple[Any, ...], Mapping[str, Any]], None]:
    """A function that rejects unknown keywords, and positional arguments that must have a keyword."""
    parameters = signature.parameters.values()
    named = [one.name for one in parameters if one.kind != inspect.Parameter.VAR_KEYWORD]
    keywords = [one.name for one in parameters if one.kind == inspect.Parameter.KEYWORD_ONLY]
    positional = [one for one in named if one not in keywords]
    known = [one for one in named if one not in ("self", "cls")]

    def check(args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> None:
        for key in kwargs:
            if key not in named and len(named) == len(parameters):
                raise InputError(f"{name}: there is no argument '{key}'" + nearest(key, known))
        if len(args) > len(positional) and keywords:
            without = " and ".join(one for one in positional if one in known)
            which = f"all arguments except {without}" if without else "all arguments"
            raise InputError(f"{name}: {which} need a keyword, such as {keywords[0]}=")

    return check


def _options(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value is of a kind; numbers of NumPy are numbers, True and False are none."""
    if kind is Any:
        return True
    options = _options(kind)
    if len(options) > 1:
        return any(_fits(value, option) for option in options)
    if kind in (float, int):
        wanted = numbers.Real if kind is float else numbers.Integral
        return isinstance(value, wanted) and not isinstance(value, bool)
    if kind is bool:
        return isinstance(value, bool | np.bool_)
    return isinstance(value, get_origin(kind) or kind)


def _words(kind: Any) -> str:
    """The kinds of value, in words."""
    kept = [get_origin(option) or option for option in _options(kind) if option is not types.NoneType]
    return " or ".join(_WORDS.get(option, f"{option.__module__}.{option.__qualname__}") for option in kept)
