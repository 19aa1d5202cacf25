"""Which files are parts of one recording, decided by their contents, not by their names."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import LATEST_NS, Storage

#: A recorder that splits files continues at once; a longer pause means a new recording.
LARGEST_GAP_NS = 5 * 10**9
#: Messages wait in the recorder's queue while it changes files, so neighboring parts may overlap a little.
LARGEST_OVERLAP_NS = 10**9


def group_splits(files: Sequence[Storage | Recording]) -> list[list[int]]:
    """Indices of the files, grouped into recordings.

    Two files belong together if the later one begins within 5 s after the end of the earlier one (or up to 1 s before
    it) and they share a topic, as from a recorder that splits files; or if they overlap in time and share no topic, as
    from two recorders that run side by side. Empty files form their own group.

    Returns:
        Groups in order of their first file; each in order of time.
    """
    groups: list[list[int]] = []
    for index in sorted(range(len(files)), key=lambda i: (files[i].start_ns or 0, i)):
        home = next((g for g in reversed(groups) if _continues([files[i] for i in g], files[index])), None)
        if home is None:
            groups.append([index])
        else:
            home.append(index)
    return sorted(groups, key=min)


def _continues(group: Sequence[Storage | Recording], file: Storage | Recording) -> bool:
    ends = [member.end_ns for member in group if member.end_ns is not None]
    if file.start_ns is None or not ends:
        return False
    gap_ns = file.start_ns - max(ends)
    topics = {channel.topic for channel in file.channels.values()}
    shared = any(topics & {channel.topic for channel in member.channels.values()} for member in group)
    if shared:
        return -LARGEST_OVERLAP_NS <= gap_ns < LARGEST_GAP_NS
    return gap_ns < 0


def undo_steps(files: Sequence[Storage]) -> None:
    """Let log times go on from file to file where the recorder's clock stepped back in one of them, or between two.

    Args:
        files: parts of one recording, in the order of writing. Other files may be among them, in any order.
    """
    for before, file in pairwise(files):
        if before.start_ns is None or before.end_ns is None or file.start_ns is None or file.end_ns is None:
            continue
        start_ns, end_ns = before.start_ns - before.shift_ns, before.end_ns - before.shift_ns
        topics = [{channel.topic for channel in one.channels.values()} for one in (before, file)]
        if file.start_ns - end_ns >= LARGEST_GAP_NS or topics[0].isdisjoint(topics[1]):
            continue
        shift_ns = before.shift_ns
        if file.start_ns < end_ns - LARGEST_OVERLAP_NS and file.end_ns > start_ns + LARGEST_OVERLAP_NS:
            shift_ns += end_ns - file.start_ns
            file.note_steps([end_ns - file.start_ns])
        if shift_ns and file.end_ns + shift_ns < LATEST_NS:
            file.delay(shift_ns)
