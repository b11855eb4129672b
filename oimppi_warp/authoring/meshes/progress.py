"""Reports the progress of making an object, for a progress bar."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Listener = Callable[[str, float], None]
"""Called with what is being done, in a few words, and the share that is done, from 0 to 1."""

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Lets ``listener`` know of the progress of everything made within the context."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def report(doing: str, share: float) -> None:
    """Tells the listener, if there is one, what is being done now.

    Args:
        doing: A few words.
        share: Share that is done, from 0 to 1.
    """
    listener = _listener.get()
    if listener is not None:
        listener(doing, share)
