"""Stop interrupts the main thread, whatever it waits for, and nothing that came later."""

import signal
import threading
import time

import pytest

from jaxscan.cli.console.desk import STOPPED, Stopping


PATIENCE_S = 30.0


def stop_soon(stopping):
    threading.Timer(0.1, stopping.stop).start()


def test_a_signal_that_the_wait_does_not_hear_is_sent_again(monkeypatch):
    sent, send = [], signal.pthread_kill

    def lose_the_first(thread, number):
        sent.append(number)
        if len(sent) > 1:
            send(thread, number)

    monkeypatch.setattr(signal, "pthread_kill", lose_the_first)
    began = time.monotonic()
    with Stopping() as stopping:
        stopping.begin()
        stop_soon(stopping)
        with pytest.raises(KeyboardInterrupt, match=STOPPED):
            threading.Event().wait(PATIENCE_S)
        heard = len(sent)
        time.sleep(0.2)
    assert len(sent) == heard == 2 and time.monotonic() - began < PATIENCE_S


def test_stop_of_one_session_does_not_end_the_next():
    with Stopping() as stopping:
        stopping.begin()
        stop_soon(stopping)
        with pytest.raises(KeyboardInterrupt):
            threading.Event().wait(PATIENCE_S)
        stopping.begin()
        assert not threading.Event().wait(0.3)
        stopping.end()
        stopping.stop()
        stopping.begin()
        assert not threading.Event().wait(0.3)
