"""Frozen: objects that cannot be changed once they are made."""

from __future__ import annotations

from typing import Any


class _Sealing(type):
    """Seals every object when its construction is done, whatever subclass constructed it."""

    def __call__(cls, *arguments: Any, **named: Any) -> Any:
        made = super().__call__(*arguments, **named)
        made.__dict__["_sealed"] = True
        return made


class Frozen(metaclass=_Sealing):
    """Base of the declared objects: attributes are set during construction and never after it."""

    def __setattr__(self, name: str, value: Any) -> None:
        if "_sealed" in self.__dict__:
            raise AttributeError(
                f"{type(self).__name__} is frozen: '{name}' cannot be set; make a new one "
                "(free, hold and the with_ methods of a problem return new ones)."
            )
        object.__setattr__(self, name, value)
