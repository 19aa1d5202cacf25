"""Scan of a container without an index: record headers are read, payloads are skipped."""

from __future__ import annotations

from dataclasses import replace

from mobilecal_cli.readers.containers.blocks import Block, BlockStorage

#: Messages outside chunks are grouped into blocks of about this many bytes.
SPAN_BYTES = 4 * 2**20


class Reindex:
    """Collects blocks and message counts during a scan of a file's records.

    The index records after a chunk give its channels and counts. A chunk is decompressed only if they are missing,
    truncated, or refer to an unknown channel, whose definition is then in that chunk.
    """

    def __init__(self, storage: BlockStorage) -> None:
        self._target = storage
        self._counts: dict[int, int] = {}
        self._chunk: Block | None = None
        self._indexed: dict[int, int] = {}
        self._span: Block | None = None

    def chunk(self, block: Block) -> None:
        """A chunk begins; its index records follow."""
        self.other()
        self._chunk = block

    def index(self, channel: int, messages: int) -> None:
        """An index record: number of messages of a channel in the last chunk."""
        if self._chunk is not None and messages:
            self._indexed[channel] = self._indexed.get(channel, 0) + messages

    def stretch(self, time_ns: int) -> None:
        """An index entry: the last chunk holds a message of this log time."""
        if self._chunk is not None:
            start_ns, end_ns = min(self._chunk.start_ns, time_ns), max(self._chunk.end_ns, time_ns)
            self._chunk = replace(self._chunk, start_ns=start_ns, end_ns=end_ns)

    def message(self, offset: int, end: int, channel: int, time_ns: int) -> None:
        """A message record outside any chunk, from byte `offset` to `end`."""
        self._close_chunk()
        span = self._span or Block(offset, 0, False, time_ns, time_ns, frozenset())
        self._span = replace(
            span,
            size=end - span.offset,
            start_ns=min(span.start_ns, time_ns),
            end_ns=max(span.end_ns, time_ns),
            channels=(span.channels or frozenset()) | {channel},
        )
        self._counts[channel] = self._counts.get(channel, 0) + 1
        if self._span.size >= SPAN_BYTES:
            self._close_span()

    def other(self) -> None:
        """Any other record: completes the open block."""
        self._close_chunk()
        self._close_span()

    def skip(self, at: int, found: int) -> int:
        """Note damage from byte `at` to the next record found; returns where to continue."""
        self.other()
        self._target.note(f"{found - at} bytes from byte {at} on are not valid records; skipped")
        return found

    def finish(self, trouble: str) -> None:
        """End the scan.

        Args:
            trouble: where the file is truncated, "" if it is complete.
        """
        self._close_chunk(cut=bool(trouble))
        self._close_span()
        storage = self._target
        storage.counts = self._counts
        if trouble:
            storage.set_time_range()
            seconds = ((storage.end_ns or 0) - (storage.start_ns or 0)) * 1e-9
            messages = sum(self._counts.values())
            storage.note(
                f"{trouble}; {messages} messages ({seconds:.1f} s) were found before it, the rest is lost"
            )

    def _close_span(self) -> None:
        if self._span is not None:
            self._target.blocks.append(self._span)
        self._span = None

    def _close_chunk(self, *, cut: bool = False) -> None:
        block, counts = self._chunk, self._indexed
        self._chunk, self._indexed = None, {}
        if block is None:
            return
        if cut or not counts or not counts.keys() <= self._target.channels.keys():
            found, start_ns, end_ns, error = self._target.scan(block, cut=cut)
            if not found and error is None:
                return
            block = replace(block, start_ns=start_ns, end_ns=end_ns) if found else block
            counts = found
        for channel, messages in counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + messages
        self._target.blocks.append(replace(block, channels=frozenset(counts) or None))
