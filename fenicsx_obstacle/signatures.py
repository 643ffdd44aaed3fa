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


def names_checked(function: Callable[P, T]) -> Callable[P, T]:
    """Decorator: reject unknown keywords, and positional arguments that must have a keyword; types are not checked."""
    name, parameters = function.__qualname__.removesuffix(".__init__"), inspect.signature(function).parameters.values()
    open_ended = any(one.kind == inspect.Parameter.VAR_KEYWORD for one in parameters)
    keywords = [one.name for one in parameters if one.kind == inspect.Parameter.KEYWORD_ONLY]
    positional = [one.name for one in parameters if one.kind == inspect.Parameter.POSITIONAL_OR_KEYWORD]
    known = [one for one in (*positional, *keywords) if one not in ("self", "cls")]

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        for key in kwargs:
            if key not in known and not open_ended:
                raise InputError(f"{name}: there is no argument '{key}'" + nearest(key, known))
        if len(args) > len(positional) and keywords:
            without = " and ".join(one for one in positional if one in known)
            which = f"all arguments except {without}" if without else "all arguments"
            raise InputError(f"{name}: {which} need a keyword, such as {keywords[0]}=")
        return function(*args, **kwargs)

    return call


def checked(**expected: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorator: check the names and types of the arguments of a function.

    Args:
        **expected: What to say is expected, where the annotation of an argument does not say it all.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        signature, name = inspect.signature(function), function.__qualname__

        @cache
        def kinds() -> dict[str, Any]:
            kept = [one for one in signature.parameters.values() if one.annotation != one.empty]
            return {one.name: eval(one.annotation, function.__globals__) for one in kept}

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> T:
            for key, value in signature.bind(*args, **kwargs).arguments.items():
                kind = kinds().get(key, Any)
                if not _fits(value, kind):
                    raise InputError(f"{name}: {key} = {shown(value)}: expected {expected.get(key) or _words(kind)}")
            return function(*args, **kwargs)

        return names_checked(call)

    return decorate


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
