"""A torch device that computes on the CPU and behaves like a GPU where mistakes are made.

`pretend:0` is a device of its own to torch (PrivateUse1, written in Python). Its tensors hide a CPU tensor; any
operation that mixes them with CPU tensors raises, as on CUDA, but for copies and for numbers (0-dim CPU tensors).
`numpy()` of them raises in torch itself. Every operation counts as a launch, and every one that makes the host wait
(`item`, `nonzero`, boolean indices, copies to the host, and copies from it that are not `non_blocking`) as a wait, by
name. Copies to the host that are `non_blocking` hold no numbers until an event after them has been waited for, which is
a wait where the device would have run out of work.
"""

from __future__ import annotations

import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils import backend_registration

NAME = "pretend"
_ROOT = Path(__file__).parents[2]
_ATEN = torch.ops.aten
_COPIES = {_ATEN.copy_.default, _ATEN._to_copy.default, _ATEN.set_.source_Tensor}
_WAITS = {
    _ATEN._local_scalar_dense.default,
    _ATEN.nonzero.default,
    _ATEN.masked_select.default,
    _ATEN.equal.default,
    _ATEN._unique2.default,
    _ATEN.unique_dim.default,
    _ATEN.repeat_interleave.Tensor,
}
_FREE = {_ATEN.detach.default, _ATEN.empty.memory_format, _ATEN.empty_strided.default, _ATEN._unsafe_view.default}
_FREE |= {_ATEN.empty_like.default, _ATEN.new_empty.default, _ATEN.new_empty_strided.default}
_TWICE = {_ATEN.select_backward.default, _ATEN.slice_backward.default, _ATEN.masked_fill.Scalar}  # fill, then copy
_AHEAD = 50  # launches after which a device is still busy when the host comes to read what was before them
_INDEXING = {_ATEN.index.Tensor, _ATEN.index_put.default, _ATEN.index_put_.default, _ATEN._index_put_impl_.default}


class MixedDevicesError(RuntimeError):
    """An operation was given tensors of the device and of the host."""


class Counts:
    """What ran on the device.

    Attributes:
        launches: by the name of the operation.
        waits: by the name of the operation and the source file that asked for it.
        places: launches by the source file.
        bytes_moved: that the operations read and wrote.
    """

    def __init__(self) -> None:
        self.launches: Counter[str] = Counter()
        self.waits: Counter[str] = Counter()
        self.places: Counter[str] = Counter()
        self.bytes_moved = 0

    def less(self, other: Counts) -> Counts:
        """These counts without those of `other`."""
        left = Counts()
        for name in ("launches", "waits", "places"):
            setattr(left, name, getattr(self, name) - getattr(other, name))
        left.bytes_moved = self.bytes_moved - other.bytes_moved
        return left


class _Queue:
    """What the device was asked for: the number of launches, and copies to the host with the numbers they will hold."""

    def __init__(self) -> None:
        self.launches = 0
        self.arriving: list[tuple[Tensor, Tensor]] = []

    def arrive(self, copies: list[tuple[Tensor, Tensor]]) -> None:
        """Fill `copies`, which have arrived, or did before."""
        for copy, numbers in copies:
            copy.copy_(numbers)
        done = {id(copy) for copy, _ in copies}
        self.arriving = [pair for pair in self.arriving if id(pair[0]) not in done]


_queue = _Queue()
_counting: list[Counts] = []
_lock = threading.Lock()


@contextmanager
def counted(into: Counts | None = None) -> Iterator[Counts]:
    """Count what runs on the device, on any thread, meanwhile; on top of `into` where that is given."""
    counts = Counts() if into is None else into
    _counting.append(counts)
    try:
        yield counts
    finally:
        _counting.remove(counts)


class DeviceTensor(Tensor):
    """A tensor on the pretend device; `held` is the CPU tensor inside."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor, requires_grad: bool = False) -> DeviceTensor:
        made = Tensor._make_wrapper_subclass(
            cls, held.size(), strides=held.stride(), storage_offset=held.storage_offset(), dtype=held.dtype,
            device=torch.device(NAME, 0), requires_grad=requires_grad,
        )  # fmt: skip
        made.held = held
        return made

    def tolist(self) -> Any:
        """The values, for which the host waits; torch does not let a tensor in Python give them itself."""
        return self.cpu().tolist()

    def __repr__(self, *, tensor_contents: object = None) -> str:
        return f"DeviceTensor({self.held!r})"

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, dict(kwargs or {}))


def _run(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """`func` on what the tensors hold; its results are on the device unless it copies to the host."""
    # as on CUDA, indices may lie on the host: they are copied, which counts as a wait
    checked = [args[0], *args[2:]] if func in _INDEXING else _leaves((args, kwargs))
    strangers = [value for value in checked if isinstance(value, Tensor) and not isinstance(value, DeviceTensor)]
    if func not in _COPIES and any(tensor.dim() > 0 for tensor in strangers):
        raise MixedDevicesError(f"{func} mixes {NAME} and cpu tensors")
    target = kwargs.get("device")
    if "device" in kwargs:
        kwargs["device"] = torch.device("cpu")
    kwargs.pop("pin_memory", None)
    results = func(*_mapped(_held, args), **_mapped(_held, kwargs))
    to_host = target is not None and target.type == "cpu"
    _count(func, args, kwargs, list(_leaves((args, kwargs, results))), to_host)
    if to_host:
        return _on_its_way(results) if kwargs.get("non_blocking") else results
    if func is _ATEN.copy_.default and not isinstance(args[0], DeviceTensor):
        return args[0]  # a copy from the device into a tensor of the host
    if func._schema.is_mutable and isinstance(args[0], DeviceTensor) and results is args[0].held:
        return args[0]
    return _mapped(lambda value: DeviceTensor(value) if isinstance(value, Tensor) else value, results)


def _leaves(value: Any) -> Iterator[Any]:
    """What lists, tuples and dictionaries hold; torch's own functions for this take most of a test's time."""
    if isinstance(value, list | tuple | dict):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _leaves(item)
    else:
        yield value


def _mapped(change: Callable[[Any], Any], value: Any) -> Any:
    """`value` with `change` made to what its lists, tuples and dictionaries hold."""
    if isinstance(value, dict):
        return {key: _mapped(change, item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return (list if isinstance(value, list) else tuple)([_mapped(change, item) for item in value])
    return change(value)


def _on_its_way(numbers: Tensor) -> Tensor:
    """A copy of `numbers` that holds none of them yet."""
    kind = torch.finfo if numbers.is_floating_point() else torch.iinfo
    copy = (
        torch.zeros_like(numbers) if numbers.dtype is torch.bool else torch.full_like(numbers, kind(numbers.dtype).min)
    )
    with _lock:
        _queue.arriving.append((copy, numbers.clone()))
    return copy


def _held(value: Any) -> Any:
    return value.held if isinstance(value, DeviceTensor) else value


def _count(func: Any, args: Any, kwargs: dict[str, Any], values: list[Any], to_host: bool) -> None:
    """Add one operation, with the tensors among `values`, to whoever counts."""
    waits = func in _WAITS or (to_host and not kwargs.get("non_blocking")) or _waits_to_copy(func, args, kwargs)
    if func in _INDEXING:  # booleans are counted first, and indices of the host copied
        indices = [index for index in _leaves(args[1]) if isinstance(index, Tensor)]
        waits = any(index.dtype is torch.bool or not isinstance(index, DeviceTensor) for index in indices)
    moved = sum(value.nbytes for value in values if isinstance(value, Tensor))
    launches = 0 if func in _FREE or _is_view(func) else 2 if func in _TWICE else 1
    with _lock:
        _queue.launches += launches
        if waits:
            _queue.arrive(_queue.arriving)
        for counts in _counting:
            if waits:
                counts.waits[f"{func} in {_place()}"] += 1
            if launches:
                counts.launches[str(func)] += launches
                counts.places[_place()] += launches
                counts.bytes_moved += moved


def _waits_to_copy(func: Any, args: Any, kwargs: dict[str, Any]) -> bool:
    """Whether a copy between host and device makes the host wait; numbers travel with the launch."""
    if func is _ATEN._to_copy.default:
        (source,) = args
        from_host = not isinstance(source, DeviceTensor)
        return from_host and source.dim() > 0 and not kwargs.get("non_blocking")
    if func is _ATEN.copy_.default:
        target, source, *more = args
        if not isinstance(target, DeviceTensor):
            return True
        return not isinstance(source, DeviceTensor) and source.dim() > 0 and not (more and more[0])
    return False


def _place() -> str:
    """The innermost source file of `core` that runs, or for a gradient the one that ran its forward pass."""
    frame: Any = sys._getframe(1)
    while frame is not None:
        if (found := _source(frame.f_code.co_filename)) is not None:
            return found
        frame = frame.f_back
    node = torch._C._current_autograd_node()
    if node is None:
        return "elsewhere"
    lines = node.metadata.get("traceback_", [])  # type: ignore[attr-defined]  # in torch's anomaly mode
    sources = [found for line in lines if (found := _source(line.partition('"')[2].partition('"')[0])) is not None]
    return sources[-1] if sources else "gradients"


@cache
def _source(path: str) -> str | None:
    """The name of a source file of `core`; None for any other file."""
    inside = Path(path).is_relative_to(_ROOT)  # the checkout's own folder may have any name
    parts = Path(path).relative_to(_ROOT).parts if inside else Path(path).parts
    return "/".join(parts[parts.index("core") :]) if "core" in parts and "tests" not in parts else None


def _is_view(func: Any) -> bool:
    aliases = [one.alias_info for one in func._schema.returns if one.alias_info is not None]
    return any(not alias.is_write for alias in aliases)


class _Generator(torch.Generator):
    """`torch.Generator` that also takes the pretend device. One of the host is not refused there: torch hides which."""

    def __new__(cls, device: Any = "cpu") -> _Generator:
        return super().__new__(cls, "cpu" if torch.device(device).type == NAME else device)  # type: ignore[call-arg]


class Event:
    """An event at this place of what the device was asked for; everything else runs at once here."""

    def __init__(self) -> None:
        with _lock:
            self._launches, self._copies = _queue.launches, list(_queue.arriving)

    def synchronize(self) -> None:
        """Wait for what was asked for before."""
        with _lock:
            _queue.arrive(self._copies)
            if _queue.launches - self._launches < _AHEAD:
                for counts in _counting:
                    counts.waits[f"event in {_place()}"] += 1

    def wait(self, stream: object = None) -> None:
        """Nothing to wait for."""


class Stream:
    """A stream; work in it is done in order, at once."""

    def __init__(self, device: object = None) -> None:
        self.device = device

    def record_event(self) -> Event:
        """An event after all that was asked for until now."""
        return Event()

    def wait_event(self, event: Event) -> None:
        """Nothing to wait for."""
        assert isinstance(event, Event)

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        return None


class Module(backend_registration._DummyBackendModule):
    """What `torch.get_device_module` gives for the device."""

    Stream, Event = Stream, Event

    def current_stream(self, device: object = None) -> Stream:
        """The one stream."""
        return Stream(device)

    def stream(self, stream: Stream) -> Stream:
        """The stream as a context."""
        return stream

    def synchronize(self, device: object = None) -> None:
        """Everything is done already."""


_registered: list[torch.library.Library] = []
# Operators that need a kernel of their own: a fallback is not asked for `_to_copy` of numbers, and the others resize
# an empty tensor, which a tensor in Python cannot follow.
_FACTORIES = ("_to_copy", "eye", "eye.m", "arange", "arange.start", "arange.start_step", "linspace")


def _factory(operator: Any) -> Any:
    return lambda *args, **kwargs: _run(operator, args, kwargs)


def can_be_registered() -> bool:
    """Whether no GPU is in the way: torch's autograd serves one kind of accelerator a process."""
    return not torch.cuda.is_available()


def register() -> str:
    """Make the device known to torch, once a process; returns its name."""
    if not _registered:
        backend_registration._setup_privateuseone_for_python_backend(NAME, backend_module=Module())
        factories = torch.library.Library("aten", "IMPL")
        library = torch.library.Library("_", "IMPL")  # every operator that names the device: factories, copies
        library.fallback(lambda func, *args, **kwargs: _run(func, args, kwargs), "PrivateUse1")
        for overload in _FACTORIES:
            operator = getattr(getattr(_ATEN, overload.split(".")[0]), overload.partition(".")[2] or "default")
            factories.impl(overload, _factory(operator), "PrivateUse1")
        _registered.extend((library, factories))
        DeviceTensor.record_stream = lambda self, stream: None  # type: ignore[method-assign]
        torch.Generator = _Generator  # type: ignore[misc,assignment]
    return NAME
