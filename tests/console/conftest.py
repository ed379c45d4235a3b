"""A console on a rig on paper: the desk in this thread, pages in another one."""

import asyncio
import json
import os
import secrets
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager

import aiohttp
import pytest

from jaxscan.cli.console.captures import Captures
from jaxscan.cli.console.desk import Desk
from jaxscan.cli.console.pages import make_site
from jaxscan.cli.console.sessions import Sessions
from jaxscan.cli.console.slate import Slate
from jaxscan.cli.console.works import Works
from jaxscan.cli.terminal import Terminal
from jaxscan.web import Server, open_address

from ..browser.driver import browser as browser
from ..hardware.desk import Desk as PaperDesk


CONFIG = """
[controller]
port = "paper"
[turntable]
full_steps = 200
microsteps = 16
gear = [9, 1]
[camera]
kind = "simulated"
width = 128
height = 96
[sweep]
steps = 10
turn_deg = 36.0
"""
PATIENCE_S = 60.0


class Page:
    """A page without a browser."""

    def __init__(self, socket, key):
        self.socket, self.key = socket, key
        self.state, self.you, self.refused = {}, {}, []
        self.pictures = 0

    async def order(self, do, **fields):
        self.finished = self.state["finished"]
        await self.socket.send_str(json.dumps({"do": do, **fields}))

    async def until(self, holds):
        """Hear the server until `holds(page)`."""
        async with asyncio.timeout(PATIENCE_S):
            while not (self.state and holds(self)):
                message = await self.socket.receive()
                if message.type is aiohttp.WSMsgType.BINARY:
                    self.pictures += message.data[0] == 1
                    continue
                assert message.type is aiohttp.WSMsgType.TEXT, (message.type, message.extra)
                found = json.loads(message.data)
                if found["kind"] == "refused":
                    self.refused.append(found["says"])
                else:
                    self.state, self.you = found["state"], found["you"]
        return self.state

    async def done(self):
        """Wait until a session has ended since the last order."""
        return await self.until(lambda page: page.state["finished"] > page.finished)


class Console:
    """A console in this process; `run` calls `pages(console)` in another thread and attends meanwhile."""

    def __init__(self, folder, port=None):
        self.config = folder / "rig.toml"
        self.config.write_text(CONFIG)
        self.address = open_address("127.0.0.1", 0, option="--web-port")
        fields = {"captures": [], "works": [], "folder": "captures", "config": "rig.toml"}
        self.slate = Slate(lost="go on", doing="nothing", finished=0, **fields)
        self.captures = Captures(folder / "captures")
        self.desk = Desk(self.config, self.slate, Terminal(), port)
        self.calibration = None

    def run(self, pages):
        problems = []
        # It prints to what is standard output in a test, not before it.
        self.desk.out = Terminal()

        async def visit():
            # Jars of aiohttp leave cookies of bare numbers out, which browsers keep.
            async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as self.session:
                async with self.session.get(self.address.url(with_token=True)) as answer:
                    assert answer.status == 200
                await pages(self)

        def work():
            try:
                asyncio.run(visit())
            except BaseException as problem:
                problems.append(problem)
            finally:
                self.desk.leave()

        with ExitStack() as stack:
            works = stack.enter_context(Works(self.slate, self.captures, self.calibration))
            Sessions(self.desk, works, self.captures)
            works.refresh()
            stack.enter_context(Server(make_site(self.address, self.desk, works, self.captures), self.address))
            thread = threading.Thread(target=work)
            thread.start()
            try:
                self.desk.attend()
            finally:
                thread.join()
        if problems:
            raise problems[0]

    def connect(self, **options):
        """A socket that has said nothing yet."""
        own = f"http://127.0.0.1:{self.address.port}"
        return self.session.ws_connect(f"{own}/socket", headers={"Origin": own}, **options)

    async def open(self, key=None):
        """A page."""
        key = key or secrets.token_hex(16)
        page = Page(await self.connect(), key)
        await page.socket.send_str(json.dumps({"page": key}))
        await page.until(lambda page: True)
        return page

    async def get(self, path):
        """The status and body of an answer; the path goes as it is."""
        from yarl import URL

        url = URL(f"http://127.0.0.1:{self.address.port}{path}", encoded=True)
        async with self.session.get(url) as answer:
            return answer.status, await answer.read()


@contextmanager
def console_process(folder):
    """A console in a process of its own, with `rig.toml` in a folder: its address, and the file with its output."""
    words = ["console", str(folder / "rig.toml"), "--captures", str(folder / "captures"), "--web-port", "0"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONUNBUFFERED": "1"}
    command, output = [sys.executable, "-m", "jaxscan.cli.main", *words], folder / "output.txt"
    with (
        open(output, "w") as out,
        subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, env=environment) as process,
    ):
        while len(output.read_text().splitlines()) < 2:  # Ended by the time limit of tests.
            assert process.poll() is None, output.read_text()
            time.sleep(0.05)
        yield output.read_text().splitlines()[0].split()[-1], output
        process.terminate()
    assert "Traceback" not in output.read_text() and "defect" not in output.read_text(), output.read_text()


@pytest.fixture
def paper(monkeypatch):
    """The desk of paper behind the names under which a rig is opened."""
    desk = PaperDesk()
    controller, camera = desk.controller, desk.camera

    class Opened(type(controller)):
        def __enter__(self):
            return self

        def __exit__(self, *_):
            self.make_safe()

    controller.__class__ = Opened
    camera.close = lambda: None
    monkeypatch.setattr("scanrig.controllers.jxs.connect", lambda port, baud, clock: controller)
    monkeypatch.setattr("scanrig.cameras.open_camera", lambda settings, say: camera)
    return desk


@pytest.fixture
def console(tmp_path, paper):
    """A console on that rig."""
    return Console(tmp_path)


@pytest.fixture
def held(paper):
    """Holds the rig before a shot: `held(shot)` gives two events, that it waits and that it may go."""

    def hold(shot):
        waits, go = threading.Event(), threading.Event()

        def wait(controller):
            waits.set()
            assert go.wait(PATIENCE_S)

        paper.controller.before_shot[shot] = wait
        return waits, go

    return hold
