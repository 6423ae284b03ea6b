"""Records (named tuples) that compiled functions hand on by their address.

Numba hands on every number of every array of a record: of the decoder's, 650 arguments in all, which every
function puts together, and takes apart again for every call: a third of all text that went to LLVM.
"""

from collections.abc import Iterable
from typing import Any, TypeVar

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.cgutils import false_bit, intp_t, voidptr_t
from numba.core.datamodel.models import PrimitiveModel
from numba.core.imputils import impl_ret_borrowed
from numba.core.registry import cpu_target
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, lower_getattr_generic, register_model, typeof_impl, unbox

__all__ = ["HandedRecord", "handed_by_address"]

Record = TypeVar("Record", bound=type)
_alloca: Any = cgutils.alloca_once
_native: Any = NativeValue
_borrowed: Any = impl_ret_borrowed


class HandedRecord(types.Type):
    """Type of such a record: its class, and the types of its fields, which are read by name only."""

    def __init__(self, record: Any, kinds: Iterable[types.Type]) -> None:
        self.record, self.fields, self.types = record, record._fields, tuple(kinds)
        super().__init__(f"{record.__name__}({', '.join(map(str, self.types))})")

    @property
    def key(self) -> Any:
        return self.record, self.types


@register_model(HandedRecord)
class _Address(PrimitiveModel):
    """Where its fields lie, one after the other, those of records within it among them: in memory of the
    function that Python calls. So it must not be kept: lists, generators and classes are told.
    """

    def __init__(self, manager: Any, kind: HandedRecord) -> None:
        models: list[Any] = [manager[field] for field in kind.types]
        own = [model.layout if isinstance(model, _Address) else model.get_value_type() for model in models]
        self.layout: Any = ir.LiteralStructType(own)
        self._offsets: list[int] | None = None
        usual: Any = super()
        usual.__init__(manager, kind, voidptr_t)

    def _kept(self, *_: Any) -> Any:
        raise NotImplementedError(f"{self.fe_type} is handed on by its address and cannot be kept")

    get_data_type = as_data = from_data = _kept

    def place(self, builder: Any, address: Any, name: str) -> Any:
        """Address of a field, as a pointer to what it is."""
        at, target = self.fe_type.fields.index(name), cpu_target.target_context.target_data
        if self._offsets is None:
            self._offsets = [self.layout.get_element_offset(target, i) for i in range(len(self.layout))]
        found = builder.gep(address, [intp_t(self._offsets[at])], inbounds=True)
        return builder.bitcast(found, self.layout.elements[at].as_pointer())


@infer_getattr
class _Fields(AttributeTemplate):
    key = HandedRecord

    def generic_resolve(self, record: Any, name: str) -> Any:  # type: ignore[override]
        """Type of a field; None: there is none of that name."""
        return dict(zip(record.fields, record.types, strict=True)).get(name)


def _model(context: Any, record: HandedRecord) -> Any:
    return context.data_model_manager[record]


@lower_getattr_generic(HandedRecord)  # type: ignore[no-untyped-call]
def _field(context: Any, builder: Any, record: HandedRecord, address: Any, name: str) -> Any:
    place = _model(context, record).place(builder, address, name)
    kind = record.types[record.fields.index(name)]
    if isinstance(kind, HandedRecord):
        return builder.bitcast(place, voidptr_t)
    return _borrowed(context, builder, kind, builder.load(place))


@unbox(HandedRecord)  # type: ignore[no-untyped-call]
def _taken_over(kind: HandedRecord, record: Any, python: Any) -> Any:
    """From Python: its fields in memory of the function that Python calls, and given back after it."""
    builder, context, model = python.builder, python.context, _model(python.context, kind)
    address = builder.bitcast(_alloca(builder, model.layout), voidptr_t)
    wrong, taken = false_bit, []
    for at, (name, field) in enumerate(zip(kind.fields, kind.types, strict=True)):
        native = python.unbox(field, python.pyapi.tuple_getitem(record, at))
        value, place = native.value, model.place(builder, address, name)
        if isinstance(field, HandedRecord):
            value = builder.load(builder.bitcast(value, place.type))
        builder.store(value, place)
        wrong = builder.or_(wrong, native.is_error)
        taken.append((field, native))

    def give_back() -> None:
        for field, native in taken:
            if native.cleanup:
                native.cleanup()
            if context.enable_nrt:
                context.nrt.decref(builder, field, native.value)

    return _native(address, is_error=wrong, cleanup=give_back)


def handed_by_address(record: Record) -> Record:
    """Decorator of a class of named tuples, whose values all kernels are to hand on so."""

    @typeof_impl.register(record)
    def _type_of(value: Any, context: Any) -> Any:
        kinds = [typeof_impl(field, context) for field in value]
        return None if None in kinds else HandedRecord(record, kinds)

    return record
