"""Lines that were typed before the question, by a person and by a program."""

import os
import pty
import tty

from jaxscan.cli.boards import Lines


def test_an_enter_of_impatience_answers_no_later_question():
    host, terminal = pty.openpty()
    tty.setraw(terminal)
    lines = Lines(terminal)
    os.write(host, b"\n\nq\n")
    lines.forget()
    os.write(host, b"s\n")
    assert lines.next(lambda: False) == "s"
    os.close(host)
    os.close(terminal)


def test_lines_of_a_pipe_are_all_heard():
    out, into = os.pipe()
    lines = Lines(out)
    os.write(into, b"\n\nq\n")
    lines.forget()
    assert [lines.next(lambda: False) for _ in range(3)] == ["", "", "q"]
    os.close(into)
    lines.forget()
    assert lines.next(lambda: False) is None and lines.ended
    os.close(out)
