"""MuJoCo's names come from a compiled module without types: pyright takes them as Any."""

from typing import Any

def __getattr__(name: str) -> Any: ...
