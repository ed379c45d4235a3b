"""`jaxscan <verb>`: the process of the command line.

Exit codes: 0; 1 bad input or a failed verdict; 2 usage; 70 a defect of jaxscan; 129, 130 or 143 ended by a signal; 141
nobody reads the output.
"""

import os
import sys

from jaxscan.cli import signals


TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: "Sequence[str] | None" = None) -> int:
    """Run one verb and return the exit code; an error of the input is printed as one line.

    Args:
        arguments: The words after `jaxscan`. None for those of this process, which then belongs to the verb: its
            signals are answered, and it ends here.
    """
    if arguments is None:
        signals.listen()
    # Imported here, because a signal may come before anything is loaded.
    from jaxscan.cli.running import run_function, run_process

    if arguments is not None:
        return run_function(list(arguments))
    code = run_process(sys.argv[1:])
    if "--debug" not in sys.argv:
        # All is written. While the interpreter ends, it answers a signal no more, and threads of XLA may crash.
        os._exit(code)
    return code


if __name__ == "__main__":
    sys.exit(main())
