"""Array fields of the data types: copied, read-only, of one element type, with checked shapes."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray


class _Nested:
    """Array fields are nested lists in files, for pydantic; numerical modules do not load it."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:  # noqa: ANN401
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(
            lambda data: np.array(data, dtype=np.float64),
            serialization=core_schema.plain_serializer_function_ser_schema(lambda array: array.tolist()),
        )


FloatArray = Annotated[NDArray[np.float64], _Nested()]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
GrayImage = NDArray[np.uint8]
Shape = tuple[int | str, ...]


class ReadOnly:
    """Base of frozen dataclasses with arrays: they are read-only copies of the annotated type and shape.

    A shape follows the type, `Annotated[FloatArray, "N", 3]`; a name stands for a size that is the same in all arrays
    of the value. Arrays without a shape, and None, stay as they are.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        """Copy and check.

        Raises:
            ValueError: a shape is wrong or a float is not finite (a programming error, never a user's error).
        """
        sizes: dict[str, int] = {}
        own: Any = type(self)
        for name, (dtype, shape) in _annotated(own).items():
            if getattr(self, name) is None:
                continue
            array = np.array(getattr(self, name), dtype=dtype)
            _check_shape(f"{type(self).__name__}.{name}", array, shape, sizes)
            if array.dtype.kind == "f" and not np.all(np.isfinite(array)):
                raise ValueError(f"{type(self).__name__}.{name}: not finite")
            array.setflags(write=False)
            object.__setattr__(self, name, array)


@cache
def _annotated(cls: type) -> dict[str, tuple[type[Any], Shape]]:
    """Name → element type and shape of the arrays with a shape."""
    shapes = {}
    for name, hint in get_type_hints(cls, include_extras=True).items():
        annotated = next((each for each in (hint, *get_args(hint)) if hasattr(each, "__metadata__")), None)
        shape = tuple(size for size in getattr(annotated, "__metadata__", ()) if isinstance(size, int | str))
        if annotated is not None and shape:
            shapes[name] = (element_of(annotated.__origin__), shape)
    return shapes


def element_of(array: Any) -> type[Any]:  # noqa: ANN401
    """Element type of `NDArray[...]`: its last argument, also of what numpy before 2.5 writes it as."""
    arguments = get_args(array)
    element: type[Any] = element_of(arguments[-1]) if arguments else array
    return element


def dtypes(cls: type) -> dict[str, np.dtype[Any]]:
    """Name → element type of the fields that are numbers or arrays with a shape, in their order."""
    arrays, hints = _annotated(cls), get_type_hints(cls)
    types = {name: arrays[name][0] if name in arrays else hints[name] for name in hints}
    return {name: np.dtype(each) for name, each in types.items() if isinstance(each, type)}


def _check_shape(name: str, array: NDArray[Any], shape: Shape, sizes: dict[str, int]) -> None:
    expected = tuple(sizes.get(n, n) if isinstance(n, str) else n for n in shape)
    fits = len(array.shape) == len(expected) and all(
        isinstance(want, str) or want == have for want, have in zip(expected, array.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"{name}: shape {array.shape}, expected {expected}")
    sizes.update({n: size for n, size in zip(shape, array.shape, strict=True) if isinstance(n, str)})


def set_corner_defaults(value: Any, covariances: str, variance: float) -> None:  # noqa: ANN401
    """Empty `seen` of a board detection means all corners; empty covariances, `variance` times identity."""
    corners = len(value.pixels)
    if not len(value.seen):
        object.__setattr__(value, "seen", np.ones(corners, dtype=np.bool_))
    if not len(getattr(value, covariances)):
        object.__setattr__(value, covariances, np.broadcast_to(variance * np.eye(2), (corners, 2, 2)))
