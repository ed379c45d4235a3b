"""Files of a public repository: a folder of it, or a bare git snapshot that may lack some files."""

import re
import subprocess
from pathlib import Path


def natural(path: str) -> list[int | str]:
    """A key of sorting that puts Image9 before Image10."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path)]


class Source:
    """One folder or git directory; nothing in it is run."""

    def __init__(self, place: Path) -> None:
        """Remember the place; a git directory is known by its `HEAD` and `objects`."""
        self.place = place
        self.is_git = (place / "HEAD").is_file() and (place / "objects").is_dir()

    def _git(self, *arguments: str) -> bytes:
        command = ["git", f"--git-dir={self.place}", *arguments]
        return subprocess.run(command, capture_output=True, check=True).stdout

    def find(self, folder: str, pattern: str) -> list[str]:
        """Files directly in a folder whose name matches the regular expression, in natural order."""
        if self.is_git:
            # The folder's slash lists what is in it, not the folder.
            names = self._git("ls-tree", "-z", "--name-only", "HEAD", f"{folder}/").decode().split("\0")
        else:
            names = [f"{folder}/{path.name}" for path in (self.place / folder).glob("*")]
        chosen = [name for name in names if re.fullmatch(pattern, name.rsplit("/", 1)[-1])]
        return sorted(chosen, key=natural)

    def read(self, path: str) -> bytes:
        """The bytes of one file."""
        if self.is_git:
            return self._git("cat-file", "blob", f"HEAD:{path}")
        return (self.place / path).read_bytes()
