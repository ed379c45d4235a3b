"""What an examination of a rig says: one finding per thing that was looked at."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from scanrig.errors import RigError


Verdict = Literal["works", "note", "wrong", "not checked"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    name: str
    verdict: Verdict
    """"note": works, but a person should know; "wrong": a scan would fail or be spoilt."""
    found: str
    do: str = ""
    """What to do about it."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """The same for programs, units in the names."""


Tell = Callable[[Finding], None]
"""Called with every finding as soon as it is made."""


def looked_at(name: str, look: Callable[[], Finding], tell: Tell) -> Finding:
    """Look at one thing; what the rig raises is a finding too, and says itself what to do."""
    try:
        finding = look()
    except RigError as problem:
        finding = Finding(name, "wrong", " ".join(str(problem).split()))
    tell(finding)
    return finding
