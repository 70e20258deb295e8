"""A cache that the tasks of one process share."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class _Slot:
    __slots__ = ("lock", "made", "value")

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.made = False
        self.value: Any = None


class Kept(Generic[T]):
    """A cache of the values that were used last. It holds a limited number of them.

    Several threads may ask at once. One thread makes a value, and threads that need it wait.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._slots: OrderedDict[Hashable, _Slot] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value of a key. Make it if it is not in the cache."""
        with self._lock:
            slot = self._slots.setdefault(key, _Slot())
            self._slots.move_to_end(key)
            while len(self._slots) > self._most:
                self._slots.popitem(last=False)
        with slot.lock:
            if not slot.made:
                slot.value = make()
                slot.made = True
            value: T = slot.value
            return value

    def drop(self, belongs: Callable[[Any], bool]) -> None:
        """Remove the values whose keys satisfy the condition."""
        with self._lock:
            for key in [key for key in self._slots if belongs(key)]:
                del self._slots[key]

    def __len__(self) -> int:
        return len(self._slots)
