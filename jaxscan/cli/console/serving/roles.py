"""Of several pages one operates, the others watch."""

import re
from dataclasses import dataclass, field


KEY = re.compile(r"[0-9a-f]{32}")
"""A page's own name, which it keeps over a reload."""
GRACE_S = 4.0
"""So long the operating page may be gone, as over a reload."""


@dataclass
class Roles:
    """Who operates. A page that comes back under its name is again what it was."""

    operator: str = ""
    """Name of the page that operates; "" before the first came."""
    lost_since: float | None = None
    """When the operating page went; None while it is there, or before one came."""
    _there: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._there)

    def join(self, name: str, now: float) -> None:
        """A page came; it operates if the one that did is not there, nor likely to come back."""
        self._there.append(name)
        if self.operator not in self._there and (self.lost_since is None or self.lost_for(now) > GRACE_S):
            self.operator = name
        if name == self.operator:
            self.lost_since = None

    def leave(self, name: str, now: float) -> None:
        """A page went."""
        self._there.remove(name)
        if name == self.operator and name not in self._there:
            self.lost_since = now

    def take_over(self, name: str) -> None:
        """A page that is there operates from now on."""
        self.operator, self.lost_since = name, None

    def lost_for(self, now: float) -> float:
        """How long the operating page is gone [s]."""
        return 0.0 if self.lost_since is None else now - self.lost_since
