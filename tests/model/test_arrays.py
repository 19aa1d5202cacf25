"""Element types of annotated arrays."""

from types import GenericAlias
from typing import Any

import numpy as np
import pytest

from mobilecal_cli.model.arrays import IntArray, element_of

BEFORE_2_5 = np.ndarray[tuple[Any, ...], np.dtype[np.int64]]
SINCE_2_5 = GenericAlias(type("NDArray", (), {}), (np.int64,))


@pytest.mark.parametrize("array", [IntArray, BEFORE_2_5, SINCE_2_5])
def test_the_element_type_however_numpy_writes_the_array(array):
    assert element_of(array) is np.int64
