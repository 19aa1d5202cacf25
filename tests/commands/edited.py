"""Copies of a sample log with something wrong in them."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_typestore

from tests.records import Record, records_of, written

STORE = get_typestore(Stores.ROS2_HUMBLE)
Edit = Callable[[str, Any], Any]


def edited(source: Path, target: Path, edit: Edit) -> Path:
    """Copy an MCAP, each decoded message through `edit(topic, message)`; None drops it."""

    def changed() -> Iterator[Record]:
        for record in records_of(source):
            message = edit(record.topic, STORE.deserialize_cdr(record.data, record.type))
            if message is not None:
                yield replace(record, data=bytes(STORE.serialize_cdr(message, record.type)))

    return written(target, changed())
