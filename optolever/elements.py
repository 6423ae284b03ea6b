"""Numbers and parts of arrays, reached without detours, in functions without numba's run time.

To reach one, numba puts what it knows of an array into memory and reads it from there, shape and strides
twice. All of it is optimised away, but was a fifth of all text that went to LLVM. What is done is the same.

Importing this tells numba.
"""

import operator
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

from llvmlite import ir
from llvmlite.ir.instructions import ExtractValue, InsertValue
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin
from numba.np import arrayobj

__all__: list[str] = []

Values = Sequence[Any]
_numba: Any = arrayobj
_place: Any = cgutils.get_item_pointer2
_unpacked: Any = cgutils.unpack_tuple
_packed: Any = cgutils.pack_array
_struct: Any = cgutils.pack_struct
_lowers: Callable[..., Callable[[Any], Any]] = lower_builtin
_INTEGER: Any = cgutils.intp_t


class _Taken:
    """What numba's functions ask of an array, taken out of its value."""

    def __init__(self, context: Any, builder: Any, kind: Any, array: Any) -> None:
        self._model, self._builder, self._array = context.data_model_manager[kind], builder, array

    def __getattr__(self, name: str) -> Any:
        value = self._builder.extract_value(self._array, self._model.get_field_position(name))
        setattr(self, name, value)
        return value


def _reached(context: Any, builder: Any, kind: Any, taken: _Taken, index: tuple[Values, Values]) -> Any:
    """Address, shape and strides of what an index (its types and values) stands for; of a number both are
    empty. None: numba is to see to it."""
    if context.enable_nrt or context.enable_boundscheck or not index[0]:
        return None
    if not all(isinstance(one, types.Integer | types.SliceType) for one in index[0]):
        return None
    if any(isinstance(one, types.SliceType) for one in index[0]):
        return _numba.basic_indexing(context, builder, kind, taken, *index)
    shape = _unpacked(builder, taken.shape, kind.ndim)
    at = [_counted(context, builder, *one) for one in zip(*index, shape, strict=False)]
    given, in_order = len(at), kind.layout == "C"
    if in_order and given == kind.ndim:
        return builder.gep(taken.data, [_offset(builder, shape, at)]), [], []
    strides = _unpacked(builder, taken.strides, kind.ndim)
    if in_order:
        place = builder.gep(taken.data, [_offset(builder, shape, at)])
    else:
        whole = at + [_INTEGER(0)] * (kind.ndim - given)
        place = _place(context, builder, taken.data, shape, strides, kind.layout, whole)
    return place, shape[given:], strides[given:]


def _counted(context: Any, builder: Any, kind: Any, value: Any, size: Any) -> Any:
    """An index, counted from the start."""
    value = _put_in(value)
    number = value.constant if isinstance(value, ir.Constant) else None
    if isinstance(number, int) and 0 <= number < 1 << (value.type.width - 1):
        return context.cast(builder, value, kind, types.intp)
    return _numba.fix_integer_index(context, builder, kind, value, size)


def _put_in(value: Any) -> Any:
    """What was put into a tuple, of what is taken out of it again."""
    while isinstance(value, ExtractValue) and len(value.indices) == 1:
        source = value.aggregate
        while isinstance(source, InsertValue) and list(source.indices) != list(value.indices):
            source = source.aggregate
        if not isinstance(source, InsertValue):
            break
        value = source.value
    return value


def _offset(builder: Any, shape: Values, at: Values) -> Any:
    """Numbers before that one, in an array whose rows lie one after the other."""
    total, step = None, None
    for axis in reversed(range(len(shape))):
        if axis < len(at):
            part = at[axis] if step is None else builder.mul(at[axis], step)
            total = part if total is None else builder.add(part, total)
        if axis:
            step = shape[axis] if step is None else builder.mul(shape[axis], step)
    return total


def _kinds(index: Any) -> Values:
    """Types of an index's parts."""
    several = isinstance(index, types.BaseTuple)
    return index.types if several else (index,)


def _index(builder: Any, kind: Any, value: Any) -> tuple[Values, Values]:
    """Types and values of an index's parts."""
    kinds = _kinds(kind)
    return kinds, _unpacked(builder, value, len(kinds)) if isinstance(kind, types.BaseTuple) else (value,)


def _view(context: Any, builder: Any, kind: Any, taken: _Taken, found: Any) -> Any:
    """The array that is part of another one."""
    place, shape, strides = found
    model = context.data_model_manager[kind]
    told = {
        "meminfo": taken.meminfo,
        "parent": taken.parent,
        "nitems": reduce(builder.mul, shape),
        "itemsize": taken.itemsize,
        "data": place,
        "shape": _packed(builder, shape),
        "strides": _packed(builder, strides),
    }
    return _struct(builder, [told[name] for name in sorted(told, key=model.get_field_position)])


@_lowers(operator.getitem, types.Array, types.Integer)
@_lowers(operator.getitem, types.Array, types.SliceType)
@_lowers(operator.getitem, types.Array, types.BaseTuple)
def _read(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """array[index]"""
    (kind, at), (array, value) = sig.args, args
    taken = _Taken(context, builder, kind, array)
    found = _reached(context, builder, kind, taken, _index(builder, at, value))
    if found is None:
        by_tuple = isinstance(at, types.BaseTuple)
        usual = _numba.getitem_array_tuple if by_tuple else _numba.getitem_arraynd_intp
        return usual(context, builder, sig, args)
    if isinstance(sig.return_type, types.Array):
        return _view(context, builder, sig.return_type, taken, found)
    return _numba.load_item(context, builder, kind, found[0])


@_lowers(operator.setitem, types.Array, types.Integer, types.Any)
@_lowers(operator.setitem, types.Array, types.BaseTuple, types.Any)
def _write(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """array[index] = number, at one place; other assignments are numba's."""
    (kind, at, given), (array, value, number) = sig.args, args
    kinds = _kinds(at)
    if len(kinds) == kind.ndim and all(isinstance(one, types.Integer) for one in kinds):
        taken = _Taken(context, builder, kind, array)
        found = _reached(context, builder, kind, taken, _index(builder, at, value))
        if found is not None:
            number = context.cast(builder, number, given, kind.dtype)
            return _numba.store_item(context, builder, kind, number, found[0])
    return _numba.setitem_array(context, builder, sig, args)


@_lowers(len, types.Array)
def _length(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """len(array)"""
    (kind,), (array,) = sig.args, args
    return builder.extract_value(_Taken(context, builder, kind, array).shape, 0)
