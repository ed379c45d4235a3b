"""Notices that nobody works on a batch any more: its workers ended, and others have to come."""

import time
import warnings
from typing import final

import distributed

from jaxscan.errors import FleetError


LOOK_S = 5.0
"""Between two questions to the scheduler."""
TOLD_S = 60.0
"""After so much time it is said, once for each absence."""


@final
class Absence:
    """How long no worker has had a task of a batch that waits for some."""

    def __init__(self, client: distributed.Client, patience_s: float) -> None:
        """Args: the client of the cluster, and how long a worker may be awaited [s]."""
        self._client, self._patience_s = client, patience_s
        self._looked = self._busy = time.monotonic()
        self._told = False

    def look(self) -> None:
        """Ask whether somebody works, if the last question was a while ago.

        Raises:
            FleetError: If nobody has worked for as long as was allowed.
        """
        now = time.monotonic()
        if now - self._looked < LOOK_S or self._client.status != "running":
            return
        self._looked = now
        if any(self._client.processing().values()):
            self._busy, self._told = now, False
        elif now - self._busy > self._patience_s:
            raise FleetError(
                f"no worker of the cluster came for {self._patience_s / 60:.0f} min; start workers and call the same "
                "command, which goes on where it was."
            )
        elif now - self._busy > TOLD_S and not self._told:
            self._told = True
            warnings.warn(
                f"no worker of the cluster has worked for {TOLD_S:.0f} s; the batch waits for one at most "
                f"{self._patience_s / 60:.0f} min.",
                RuntimeWarning,
                stacklevel=2,
            )
