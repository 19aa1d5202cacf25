"""Array fields of the data types: copied, read-only, of one element type, with checked shapes."""

from __future__ import annotations

from typing import Annotated, Any

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
Shape = tuple[int | str, ...]
BoolArray = NDArray[np.bool_]
GrayImage = NDArray[np.uint8]


def _checked(name: str, array: NDArray[Any], shape: Shape, sizes: dict[str, int]) -> None:
    expected = tuple(sizes.get(n, n) if isinstance(n, str) else n for n in shape)
    fits = len(array.shape) == len(expected) and all(
        isinstance(want, str) or want == have for want, have in zip(expected, array.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"{name}: shape {array.shape}, expected {expected}")
    sizes.update({n: size for n, size in zip(shape, array.shape, strict=True) if isinstance(n, str)})


def freeze(
    value: object, dtype: type[Any] = np.float64, /, **shapes: tuple[int | str, ...]
) -> dict[str, int]:
    """Replace the named attributes of a frozen dataclass by read-only copies of the given dtype.

    Args:
        value: the dataclass instance, inside its ``__post_init__``.
        dtype: element type of the named attributes.
        shapes: attribute name → shape; a string names a size that must be the same everywhere.

    Returns:
        The sizes that the strings name.

    Raises:
        ValueError: a shape is wrong or a float is not finite (a programming error, never a user's error).
    """
    sizes: dict[str, int] = {}
    for name, shape in shapes.items():
        array = np.array(getattr(value, name), dtype=dtype)
        _checked(f"{type(value).__name__}.{name}", array, shape, sizes)
        if np.issubdtype(array.dtype, np.floating) and not np.all(np.isfinite(array)):
            raise ValueError(f"{type(value).__name__}.{name}: not finite")
        array.setflags(write=False)
        object.__setattr__(value, name, array)
    return sizes


def freeze_corners(value: object, seen: BoolArray) -> None:
    """Freeze `pixels` (M, 2) and `seen` (M,) of a board detection; an empty `seen` means all corners.

    Raises:
        ValueError: see `freeze`.
    """
    corners = freeze(value, pixels=("M", 2))["M"]
    if not len(seen):
        object.__setattr__(value, "seen", np.ones(corners, dtype=np.bool_))
    freeze(value, np.bool_, seen=(corners,))


def freeze_covariances(value: object, name: str, given: FloatArray, default: float) -> None:
    """Freeze one (2, 2) covariance per corner, (M, 2, 2), after `freeze_corners`; default: `default` times identity.

    Raises:
        ValueError: see `freeze`.
    """
    corners = len(value.pixels)  # type: ignore[attr-defined]
    if not len(given):
        object.__setattr__(value, name, np.broadcast_to(default * np.eye(2), (corners, 2, 2)))
    freeze(value, **{name: (corners, 2, 2)})
