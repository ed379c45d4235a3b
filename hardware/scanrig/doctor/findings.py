"""The findings of an examination, one for each part."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from scanrig.errors import RigError


Verdict = Literal["works", "note", "wrong", "not checked"]


@dataclass(frozen=True)
class Finding:
    """The finding about one part."""

    name: str
    verdict: Verdict
    """"note": works, with a remark; "wrong": a scan would fail or be spoilt."""
    found: str
    do: str = ""
    """The remedy."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """The measured values, for programs; units in the names."""


Tell = Callable[[Finding], None]
"""Called with each finding at once."""


def looked_at(name: str, look: Callable[[], Finding], tell: Tell) -> Finding:
    """Examine one part. An error of the rig becomes a finding; its message contains the remedy."""
    try:
        finding = look()
    except RigError as problem:
        finding = Finding(name, "wrong", " ".join(str(problem).split()))
    tell(finding)
    return finding
