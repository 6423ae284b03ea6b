"""Types of numba's own functions, kept from one kernel to the next."""

import operator
from typing import Any

import numpy as np
from numba import njit, types
from numba.core.types.functions import BaseFunction

from optolever import typing_memory
from optolever.compiling import Usual
from optolever.typing_memory import remembering_types


def test_what_is_remembered_is_what_numba_answers() -> None:
    @njit(pipeline_class=Usual)
    def work(values: Any, number: Any) -> Any:
        total = number
        for x in range(len(values)):
            total = total + np.sqrt(abs(values[x] * number)) + max(values[x], -number)
        return total

    kinds = np.float32, np.float64, np.int16, np.uint8
    asked = [(np.arange(-4, 5).astype(kind), kind(3)) for kind in kinds]
    before = len(typing_memory._memory)
    told, usual = [work(*each) for each in asked], njit(work.py_func)
    assert told == [usual(*each) for each in asked]
    fresh = list(typing_memory._memory.items())[before:]
    assert any(function.typing_key is operator.mul for (function, *_), _ in fresh)
    for (function, context, args), signature in fresh:
        assert BaseFunction.get_call_type(function, context, args, {}) == signature
        assert function.get_impl_key(signature) is function.typing_key


def test_it_is_asked_once_and_numba_is_left_as_it_was() -> None:
    usual, asked = typing_memory._usual, []

    def counted(function: Any, *told: Any) -> Any:
        asked.append(function.typing_key)
        return usual(function, *told)

    def power(x: Any) -> Any:
        return operator.pow(x, x)

    typing_memory._usual = counted
    try:
        for _ in range(2):
            njit((types.complex64,), pipeline_class=Usual)(power)
    finally:
        typing_memory._usual = usual
    assert asked.count(operator.pow) == 1
    with remembering_types():
        assert BaseFunction.get_call_type is not usual
    assert BaseFunction.get_call_type is usual
