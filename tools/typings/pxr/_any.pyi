"""A module whose names are all Any."""

from typing import Any

def __getattr__(name: str) -> Any: ...
