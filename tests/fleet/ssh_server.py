"""An SSH server on the loopback for one test: `python ssh_server.py FOLDER` prints its port.

FOLDER has the key `host` of the server, and in `authorized` the key of who is let in. Commands are run as sshd does,
and are noted in FOLDER/commands, one in each line.
"""

import asyncio
import contextlib
import os
import signal
import sys
from pathlib import Path

import asyncssh


FOLDER = Path(sys.argv[1])


async def run(process: asyncssh.SSHServerProcess) -> None:
    with open(FOLDER / "commands", "a") as notes:
        notes.write(f"{process.command}\n")
    child = await asyncio.create_subprocess_exec(
        *("/bin/sh", "-c", process.command),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,
    )
    await process.redirect(stdout=child.stdout, stderr=child.stderr)
    ways = [asyncio.ensure_future(child.wait()), asyncio.ensure_future(until_told(process))]
    await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    for way in ways:
        way.cancel()
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)
    process.exit(await child.wait())


async def until_told(process: asyncssh.SSHServerProcess) -> None:
    """Until the client sends a signal, or has gone."""
    with contextlib.suppress(asyncssh.SignalReceived):
        await process.stdin.read()
        await process.channel.wait_closed()


async def main() -> None:
    async with asyncssh.listen(
        "127.0.0.1",
        0,
        server_host_keys=[str(FOLDER / "host")],
        authorized_client_keys=str(FOLDER / "authorized"),
        process_factory=run,
        sftp_factory=True,
        encoding=None,
    ) as server:
        print(server.get_port(), flush=True)
        await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)


asyncio.run(main())
