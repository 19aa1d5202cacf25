"""Databases that lack the pages above their leaves: cut while they were copied, or damaged there."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import numpy as np
import pytest

from mobilecal_cli.readers.containers.sqlite import SqliteStorage

_PAGE, _MESSAGES = 512, 4000


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    """A file with several levels of pages, and the size that it had after each message."""
    path = tmp_path_factory.mktemp("whole") / "log.db3"
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute(f"PRAGMA page_size={_PAGE}")
        connection.execute("PRAGMA journal_mode=OFF")
        connection.execute("PRAGMA synchronous=OFF")
        connection.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format)")
        connection.execute(
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        connection.execute("INSERT INTO topics VALUES (1, '/text', 'std_msgs/msg/String', 'cdr')")
        sizes = []
        for number in range(1, _MESSAGES + 1):
            data = number.to_bytes(4) * (400 if number % 10 == 0 else 20)  # some need further pages
            connection.execute("INSERT INTO messages VALUES (?, 1, ?, ?)", (number, 10**18 + number, data))
            if number % 20 == 0:
                sizes.append((path.stat().st_size, number))
    return path, sizes


def _read(path):
    storage = SqliteStorage(path)
    try:
        return [(m.log_time_ns - 10**18, m.payload) for m in storage.messages(["/text"])], storage.damage
    finally:
        storage.close()


def _are_right(messages):
    return all(data == number.to_bytes(4) * (len(data) // 4) for number, data in messages)


@pytest.mark.parametrize("share", [0.1, 0.37, 0.6, 0.85, 0.99])
def test_all_messages_before_a_cut_are_read(database, tmp_path, share):
    whole, sizes = database
    cut = int(share * whole.stat().st_size)
    (path := tmp_path / "cut.db3").write_bytes(whole.read_bytes()[:cut])
    messages, damage = _read(path)
    before = max(number for size, number in sizes if size <= cut)
    assert [number for number, _ in messages[:before]] == list(range(1, before + 1))
    assert _are_right(messages)
    assert damage
    assert path.stat().st_size == cut


def _lost(page):
    page[:] = 0xFF


def _wrong_key(page):
    """Rows are still found one after another, but not by their numbers."""
    cell = int.from_bytes(page[12:14].tobytes())
    page[cell + 4] = 0x80  # after the number of the child, a key of two bytes


@pytest.mark.parametrize("damage", [_lost, _wrong_key])
def test_one_damaged_interior_page_costs_no_message(database, tmp_path, damage):
    whole, _ = database
    content = np.frombuffer(whole.read_bytes(), np.uint8).copy()
    pages = content.reshape(-1, _PAGE)
    interior = np.flatnonzero(pages[:, 0] == 5)
    assert len(interior) > 2
    damage(pages[interior[1]])
    (path := tmp_path / "damaged.db3").write_bytes(content.tobytes())
    messages, _ = _read(path)
    assert [number for number, _ in messages] == list(range(1, _MESSAGES + 1))
    assert _are_right(messages)
