"""The index of a torch file, read without pickle.

`torch.save` and `torch.jit.save` describe the objects of a file in the language of pickle, whose
programs can call any function of Python. This reads the few instructions that a description of
tensors needs, and calls nothing: a tensor becomes a `TensorRef`, an object of a scripted module a
`Record`, and any other call is refused by its name. It is stricter than `weights_only`.

The parameters that brax saves are a pickle of their own (`pickle.dump`), with NumPy's arrays, or
those of JAX, in it. Such a file is read in the same way: an array becomes a `TensorRef` whose
numbers are those of the pickle. In a file of joblib the numbers of an array stand in the file
itself, behind the instruction that describes it.
"""

from __future__ import annotations

import io
import math
import pickletools
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from nw_base.clean import clean
from nw_base.errors import PolicyError
from nw_policies.safety.archive import FileLimits

STORAGES = {
    "DoubleStorage": "float64",
    "FloatStorage": "float32",
    "HalfStorage": "float16",
    "BFloat16Storage": "bfloat16",
    "LongStorage": "int64",
    "IntStorage": "int32",
    "ShortStorage": "int16",
    "CharStorage": "int8",
    "ByteStorage": "uint8",
    "BoolStorage": "bool",
}
_ARRAYS = {
    "f8": "float64",
    "f4": "float32",
    "f2": "float16",
    "i8": "int64",
    "i4": "int32",
    "i2": "int16",
    "i1": "int8",
    "u8": "uint64",
    "u4": "uint32",
    "u2": "uint16",
    "u1": "uint8",
    "b1": "bool",
}
"""Types of NumPy's arrays, as it pickles them."""
ITEM_BYTES = {
    "float64": 8,
    "float32": 4,
    "float16": 2,
    "bfloat16": 2,
    "int64": 8,
    "int32": 4,
    "int16": 2,
    "int8": 1,
    "uint64": 8,
    "uint32": 4,
    "uint16": 2,
    "uint8": 1,
    "bool": 1,
}


@dataclass(frozen=True, kw_only=True)
class StorageRef:
    """A run of numbers in a member of the archive, or in the pickle itself."""

    key: str
    dtype: str
    count: int
    raw: bytes | None = None
    """The numbers, where they stand in the pickle."""


@dataclass(frozen=True, kw_only=True)
class TensorRef:
    """A tensor as the index describes it; its numbers have not been read."""

    storage: StorageRef
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Global:
    """A class or function that the index names."""

    name: str


@dataclass(kw_only=True)
class Record:
    """An object of a scripted module, or of brax: its class and its attributes.

    An array of NumPy has its `TensorRef` in place of them.
    """

    name: str
    state: Any = field(default=None)


@dataclass(frozen=True, kw_only=True)
class Index:
    """All that an index describes, whether or not its result still holds it.

    Torch makes a tensor of every description, also of one that is then thrown away.
    """

    tree: Any
    """Dicts, lists, tuples, strings, numbers, None, `TensorRef`, `Record`, `Opaque`."""
    storages: tuple[StorageRef, ...]
    tensors: tuple[TensorRef, ...]
    classes: frozenset[str]
    """Of all `Record`s."""
    types: frozenset[str]
    """Types that lists and dicts of a script are marked with."""


@dataclass(frozen=True, kw_only=True)
class Opaque:
    """A harmless value of which no tensor is made, such as a NumPy scalar."""

    name: str
    number: TensorRef | None = None
    """Of a NumPy scalar in a pickle: the number, as an array without axes."""


_SCALAR = {"numpy.core.multiarray.scalar", "numpy._core.multiarray.scalar"}
_OPAQUE = {
    "_codecs.encode",
    *_SCALAR,
    "numpy.dtype",
    # Of the random generator that a space of Gymnasium keeps.
    "numpy.random._pickle.__generator_ctor",
    "numpy.random._pickle.__bit_generator_ctor",
    "numpy.random.bit_generator.__pyx_unpickle_SeedSequence",
}
_OBJECTS = re.compile(
    r"(brax|flax|optax|gymnasium\.spaces|gym\.spaces)\.[\w.]+|joblib\.numpy_pickle\.NumpyArrayWrapper"
    r"|stable_baselines3\.common\.(vec_env\.vec_normalize\.VecNormalize"
    r"|running_mean_std\.RunningMeanStd)"
)
"""Classes of a pickled training whose attributes are read; nothing is imported."""
_RECONSTRUCT = {"numpy.core.multiarray._reconstruct", "numpy._core.multiarray._reconstruct"}
_ARRAY = "numpy.ndarray"
_JOBLIB = "joblib.numpy_pickle.NumpyArrayWrapper"
"""What joblib writes before the numbers of an array."""
# `meta` has no numbers: an operator on such a tensor reads memory of somebody else's.
_DEVICE = re.compile(r"(?!meta)[a-z]+(:[0-9]+)?")
# How TorchScript writes lists with the type of their elements: the list is the first argument.
_SCRIPT_LISTS = {
    "torch.jit._pickle.restore_type_tag",
    *(f"torch.jit._pickle.build_{kind}list" for kind in ("int", "double", "bool", "tensor")),
}
_MARK = object()


class _RefusedError(Exception):
    """The index asks for something that no description of tensors needs."""


def read_objects(index: bytes, where: str, limits: FileLimits | None = None) -> Any:
    """Return the objects that an index describes.

    Args:
        index: contents of a member `data.pkl` or `constants.pkl`.
        where: path of the file, for errors.
        limits: bounds; the index is at most `index_bytes` long.

    Returns:
        Index.tree

    Raises:
        PolicyError: the index is damaged, or asks to call a function.
    """
    return read_index(index, where, limits).tree


def read_index(
    index: bytes, where: str, limits: FileLimits | None = None, *, pickled: bool = False
) -> Index:
    """Return what `read_objects` does, and all that was described on the way.

    Args:
        index: as for `read_objects`.
        where: as for `read_objects`.
        limits: as for `read_objects`.
        pickled: whether it is a file of `pickle.dump`, which may hold arrays.

    Raises:
        PolicyError: as `read_objects`.
    """
    limits = limits or FileLimits()
    machine = _Machine(pickled=pickled)
    stream = io.BytesIO(index)
    try:
        for opcode, argument, _ in pickletools.genops(stream):
            _instruction(opcode.name, pickled=pickled)(machine, argument)
            if pickled and opcode.name == "BUILD":
                machine.array_behind(stream)
        tree = machine.result()
    except _RefusedError as error:
        raise PolicyError(
            f"{where}: the file {clean(error, at_most=200)}; weights do not need that, so it is "
            "not opened",
            fix="do not use this file, or save the plain state dict where you trust it",
        ) from None
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
        raise PolicyError(
            f"{where}: the index of the file is damaged: {clean(error, at_most=200)}",
            fix="copy or download the file again",
        ) from None
    return Index(
        tree=tree,
        storages=tuple(machine.storages),
        tensors=tuple(machine.tensors),
        classes=frozenset(machine.classes),
        types=frozenset(machine.types),
    )


class _Machine:
    """The stack of a pickle program."""

    def __init__(self, *, pickled: bool) -> None:
        self.pickled = pickled
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self.done = False
        self.storages: list[StorageRef] = []
        self.tensors: list[TensorRef] = []
        self.classes: set[str] = set()
        self.types: set[str] = set()

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def pop(self) -> Any:
        value = self.stack.pop()
        if value is _MARK:
            raise ValueError("a mark instead of a value")
        return value

    def to_mark(self) -> list[Any]:
        """Remove and return everything above the last mark."""
        for index in range(len(self.stack) - 1, -1, -1):
            if self.stack[index] is _MARK:
                values = self.stack[index + 1 :]
                del self.stack[index:]
                return values
        raise ValueError("no mark")

    def result(self) -> Any:
        if not self.done or len(self.stack) != 1:
            raise ValueError("it ends early")
        return self.pop()

    def tuple_of(self, count: int) -> None:
        values = [self.pop() for _ in range(count)]
        self.push(tuple(reversed(values)))

    def global_named(self, module: str, name: str) -> None:
        self.push(Global(name=f"{module}.{name}"))

    def stack_global(self) -> None:
        name, module = self.pop(), self.pop()
        self.global_named(str(module), str(name))

    def set_items(self, values: list[Any]) -> None:
        target = self.stack[-1]
        if not isinstance(target, dict):
            raise TypeError("items for something that is not a dict")
        for key, value in zip(values[::2], values[1::2], strict=True):
            if not isinstance(key, str | int | float | bool | tuple | None):
                raise _RefusedError(f"has a {type(key).__name__} as a key")
            target[key] = value

    def append(self, values: list[Any]) -> None:
        target = self.stack[-1]
        if not isinstance(target, list):
            raise TypeError("elements for something that is not a list")
        target.extend(values)

    def reduce(self) -> None:
        arguments, function = self.pop(), self.pop()
        if not isinstance(function, Global) or not isinstance(arguments, tuple):
            raise _RefusedError("calls a computed value")
        call = _call_of_arrays if self.pickled else _call
        result = call(function.name, arguments)
        if isinstance(result, TensorRef):
            self.tensors.append(result)
        if function.name in _SCRIPT_LISTS:
            self.types |= {str(kind) for kind in arguments[1:]}
        self.push(result)

    def new_object(self) -> None:
        arguments, cls = self.pop(), self.pop()
        if self.pickled and isinstance(cls, Global) and _OBJECTS.fullmatch(cls.name):
            # A named tuple has its fields as arguments, other objects have a state later.
            self.push(Record(name=cls.name, state=arguments or None))
            return
        if not isinstance(cls, Global) or not cls.name.startswith("__torch__."):
            raise _RefusedError(f"makes an object of {getattr(cls, 'name', 'a computed class')}")
        self.classes.add(cls.name)
        self.push(Record(name=cls.name))

    def build(self) -> None:
        state = self.pop()
        target = self.stack[-1]
        if isinstance(target, Record):
            target.state = _array(state) if target.name == _ARRAY else state
        elif isinstance(target, _Dtype) and isinstance(state, tuple) and len(state) > 1:
            if state[1] not in {"<", "|", "="}:
                raise _RefusedError("has big-endian numbers")
        # The only other state in torch files is `_metadata` of a state dict, which is of no use,
        # and that of opaque values.
        elif not isinstance(target, dict | Opaque):
            raise _RefusedError(f"sets the state of a {type(target).__name__}")

    def array_behind(self, stream: io.BytesIO) -> None:
        """Read the numbers that joblib writes behind the description of an array, if that is last.

        They begin after a byte that says how many bytes of padding follow it, if the description
        has an alignment.
        """
        target = self.stack[-1]
        if not isinstance(target, Record) or target.name != _JOBLIB:
            return
        match target.state:
            case {"shape": tuple() as size, "order": str() as order, "dtype": _Dtype() as dtype}:
                shape = _integers(size)
            case _:
                raise ValueError("an array with a malformed description")
        if target.state.get("numpy_array_alignment_bytes") is not None:
            stream.read(int.from_bytes(stream.read(1), "little"))
        count = math.prod(shape) * ITEM_BYTES[dtype.name]
        if count < 0:
            raise ValueError(f"an array of shape {shape}")
        target.state = _array((None, shape, dtype, order == "F", stream.read(count)))

    def storage(self) -> None:
        match self.pop():
            case ("storage", Global(name=name), key, str() as device, int() as count) if (
                count >= 0 and _DEVICE.fullmatch(device)
            ):
                dtype = STORAGES.get(name.removeprefix("torch."))
                if dtype is None:
                    raise _RefusedError(f"has numbers of the type {name}")
                self.storages.append(StorageRef(key=str(key), dtype=dtype, count=count))
                self.push(self.storages[-1])
            case other:
                raise _RefusedError(f"refers to {str(other)[:80]} outside itself")


def _call(name: str, arguments: tuple[Any, ...]) -> Any:
    match name, arguments:
        case "collections.OrderedDict", ():
            return {}
        case "collections.OrderedDict", ([*pairs],):
            return dict(pairs)
        case "torch._utils._rebuild_tensor_v2", (StorageRef() as storage, offset, size, stride, *_):
            shape, strides = _integers(size), _integers(stride)
            if not isinstance(offset, int) or len(shape) != len(strides):
                raise ValueError("a tensor with a malformed shape")
            return TensorRef(storage=storage, offset=offset, shape=shape, strides=strides)
        case "torch._utils._rebuild_parameter", (TensorRef() as tensor, *_):
            return tensor
        case "torch.Size", ((*size,),):
            return tuple(size)
        case _ if name in _SCRIPT_LISTS and arguments:
            return arguments[0]
        case "torch.device", (str() as device, *_) if _DEVICE.fullmatch(device):
            return Opaque(name=name)
        case _ if name in _OPAQUE:
            return Opaque(name=name)
        case _:
            raise _RefusedError(f"asks to call {name[:80]!r}")


@dataclass(frozen=True, kw_only=True)
class _Dtype:
    """A type of NumPy's arrays."""

    name: str


def _call_of_arrays(name: str, arguments: tuple[Any, ...]) -> Any:
    """Return what a call in a pickle of arrays stands for."""
    match name, arguments:
        case "numpy.dtype", (str() as kind, *_):
            if kind not in _ARRAYS:
                raise _RefusedError(f"has numbers of the type {kind[:20]}")
            return _Dtype(name=_ARRAYS[kind])
        case _, (Global(name="numpy.ndarray"), *_) if name in _RECONSTRUCT:
            return Record(name=_ARRAY)
        case (
            "jax._src.array._reconstruct_array",
            (Global(name=function), (Global(name="numpy.ndarray"), *_), state, *_),
        ) if function in _RECONSTRUCT:
            return Record(name=_ARRAY, state=_array(state))
        case _, (_Dtype() as dtype, bytes() as raw) if name in _SCALAR:
            return Opaque(name=name, number=_array((None, (), dtype, False, raw)))
        case "_codecs.encode", (str() as letters, "latin1"):  # Bytes, before protocol 3.
            return letters.encode("latin1")
        case "flax.core.frozen_dict.FrozenDict", (dict() as items,):
            return items
        # A tensor in a pickle is a file of torch in it, which nothing here needs.
        case ("torch.storage._load_from_bytes", (bytes(),)) | (
            "torch._utils._rebuild_tensor_v2",
            (Opaque(), *_),
        ):
            return Opaque(name=name)
        case _, (str() | int(),) if _OBJECTS.fullmatch(name):  # A member of an enumeration.
            return Opaque(name=name)
        case _:
            return _call(name, arguments)


def _array(state: Any) -> TensorRef:
    """Return an array from the state that NumPy gives it."""
    match state:
        case (_, tuple() as size, _Dtype(name=dtype), bool() as columns, bytes() as raw):
            shape = _integers(size)
        case _:
            raise ValueError("an array with a malformed state")
    count = math.prod(shape)
    if count < 0 or count * ITEM_BYTES[dtype] != len(raw):
        raise ValueError(f"an array of shape {shape} with {len(raw)} bytes")
    order = shape if columns else shape[::-1]
    strides = [math.prod(order[:index]) for index in range(len(order))]
    return TensorRef(
        storage=StorageRef(key="", dtype=dtype, count=count, raw=raw),
        offset=0,
        shape=shape,
        strides=tuple(strides if columns else strides[::-1]),
    )


def _integers(values: Any) -> tuple[int, ...]:
    if not isinstance(values, tuple) or not all(type(value) is int for value in values):
        raise ValueError("a tensor with a malformed shape")
    return values


def _put(machine: _Machine, argument: Any) -> None:
    if int(argument) > len(machine.memo):  # Torch would make room for all places before it.
        raise ValueError("a memory reference that is out of order")
    machine.memo[int(argument)] = machine.stack[-1]


def _memoize(machine: _Machine, _: Any) -> None:
    machine.memo[len(machine.memo)] = machine.stack[-1]


def _get(machine: _Machine, argument: Any) -> None:
    machine.push(machine.memo[int(argument)])


def _global(machine: _Machine, argument: Any) -> None:
    module, _, name = str(argument).partition(" ")
    machine.global_named(module, name)


def _set_item(machine: _Machine, _: Any) -> None:
    value, key = machine.pop(), machine.pop()
    machine.set_items([key, value])


def _stop(machine: _Machine, _: Any) -> None:
    machine.done = True


_Instruction = Callable[[_Machine, Any], None]


def _pushes(value: Any) -> _Instruction:
    return lambda machine, _: machine.push(value)


def _literal(machine: _Machine, argument: Any) -> None:
    machine.push(argument)


def _nothing(machine: _Machine, argument: Any) -> None:
    """Protocol and frame marks carry no meaning."""


_INSTRUCTIONS: dict[str, _Instruction] = {
    "PROTO": _nothing,
    "FRAME": _nothing,
    "STOP": _stop,
    "MARK": _pushes(_MARK),
    "NONE": _pushes(None),
    "NEWTRUE": _pushes(True),
    "NEWFALSE": _pushes(False),
    "EMPTY_TUPLE": _pushes(()),
    "EMPTY_DICT": lambda machine, _: machine.push({}),
    "EMPTY_LIST": lambda machine, _: machine.push([]),
    **dict.fromkeys(("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"), _literal),
    **dict.fromkeys(("BINUNICODE", "SHORT_BINUNICODE"), _literal),
    **dict.fromkeys(("BINPUT", "LONG_BINPUT"), _put),
    "MEMOIZE": _memoize,
    **dict.fromkeys(("BINGET", "LONG_BINGET"), _get),
    "GLOBAL": _global,
    "STACK_GLOBAL": lambda machine, _: machine.stack_global(),
    "BINPERSID": lambda machine, _: machine.storage(),
    "TUPLE1": lambda machine, _: machine.tuple_of(1),
    "TUPLE2": lambda machine, _: machine.tuple_of(2),
    "TUPLE3": lambda machine, _: machine.tuple_of(3),
    "TUPLE": lambda machine, _: machine.push(tuple(machine.to_mark())),
    "SETITEM": _set_item,
    "SETITEMS": lambda machine, _: machine.set_items(machine.to_mark()),
    "APPEND": lambda machine, _: machine.append([machine.pop()]),
    "APPENDS": lambda machine, _: machine.append(machine.to_mark()),
    "REDUCE": lambda machine, _: machine.reduce(),
    "NEWOBJ": lambda machine, _: machine.new_object(),
    "BUILD": lambda machine, _: machine.build(),
}


_BYTES = frozenset({"BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BINUNICODE8"})
"""Instructions of later protocols, which torch does not write."""


def _instruction(name: str, *, pickled: bool) -> _Instruction:
    if pickled and name in _BYTES:
        return _literal
    if name not in _INSTRUCTIONS:
        raise _RefusedError(f"has the instruction {name}")
    return _INSTRUCTIONS[name]
