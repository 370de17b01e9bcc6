"""Configurations in which an unknown key is an error."""

from typing import TypeVar

T = TypeVar("T", bound=type)


def strict(cls: T) -> T:
    """Let `lf_flame._common.config.build` refuse keys that a configuration dataclass has not."""
    cls.__pydantic_config__ = {"extra": "forbid"}  # type: ignore[attr-defined]
    return cls
