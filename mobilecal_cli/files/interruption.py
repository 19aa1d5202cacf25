"""Signals that end a command: the running code unwinds, so that every `with` block cleans up."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from types import FrameType

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
#: A terminal that closes sends several signals at once; they must not cut the clean-up short.
_REPEATED_S = 2.0
_AGAIN_S = 0.05


class Interrupted(SystemExit):
    """A signal ended the command; the exit code is 128 plus its number."""


#: Outputs of this process that are complete and in place.
placed: list[Path] = []


class _State:
    """Signals of this process, which has one handler."""

    received: int | None = None
    at_s = 0.0
    deferring = 0
    pending = False


def unwind_on_signals() -> None:
    """Turn SIGINT, SIGTERM and SIGHUP into `Interrupted`; a signal that the caller ignores (nohup) stays ignored."""
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _on_signal)
    sys.unraisablehook = _on_unraisable


def _on_signal(number: int, frame: FrameType | None) -> None:
    now = time.monotonic()
    if _State.received is not None and now - _State.at_s < _REPEATED_S:
        return
    _State.received, _State.at_s = number, now
    _State.pending = _State.deferring > 0
    if not _State.pending:
        raise Interrupted(128 + number)


def _on_unraisable(error: sys.UnraisableHookArgs) -> None:
    """Send a signal again that came while Python called a destructor, which swallows exceptions."""
    if not isinstance(error.exc_value, Interrupted) or _State.received is None:
        sys.__unraisablehook__(error)
        return
    number, _State.received = _State.received, None
    Timer(_AGAIN_S, os.kill, (os.getpid(), number)).start()


@contextmanager
def naming_interruptions() -> Iterator[None]:
    """Raise `Interrupted` for a signal that other code has swallowed, or turned into another error.

    An import that a signal cuts short may do either, above all that of an extension module: the next import raises
    it again, or else the end of the block.
    """
    sys.meta_path.insert(0, _Swallowed)
    try:
        yield
    except Exception as error:
        if _State.received is None:
            raise
        raise Interrupted(128 + _State.received) from error
    finally:
        sys.meta_path.remove(_Swallowed)
    _raise_swallowed()


class _Swallowed:
    """A finder of modules that finds none; importing goes on if no signal was swallowed."""

    @staticmethod
    def find_spec(*_: object) -> None:
        """See `_raise_swallowed`."""
        _raise_swallowed()


def _raise_swallowed() -> None:
    """Raise `Interrupted` if a signal has come that takes effect at once, and nothing unwinds."""
    error = sys.exception()
    while error is not None and not isinstance(error, Interrupted):
        error = error.__context__
    if _State.received is not None and error is None and not _State.deferring:
        raise Interrupted(128 + _State.received)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """A short step that must not stop halfway: a signal inside the block takes effect at its end."""
    _State.deferring += 1
    try:
        yield
    finally:
        _State.deferring -= 1
    if _State.received is not None and _State.pending and not _State.deferring:
        _State.pending = False
        raise Interrupted(128 + _State.received)
