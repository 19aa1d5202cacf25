"""Recordings that several modules read and none changes."""

from functools import cache

import pytest

from . import recordings as r


@pytest.fixture(scope="session")
def in_container(tmp_path_factory):
    """Name of a container → path of `r.world()` in it."""
    folder = tmp_path_factory.mktemp("containers")
    return cache(lambda name: r.CONTAINERS[name](folder / name, r.world()))
