"""The operator: keys, signals, and a run that ends because of them."""

import os
import pty
import signal
import subprocess
import sys
import threading
import time

import pytest
from deploy import ControllerConfig, run
from deploy.control.clock import WallClock
from deploy.control.operator import Interrupts, Keyboard, Unattended

QUICK = ControllerConfig(passive_s=0.04, stand_up_s=0.2, hold_s=0.1, ramp_in_s=0.08)


@pytest.fixture
def keys():
    """A keyboard without echo or line buffer: a pseudo terminal, and what types on it."""
    master, slave = pty.openpty()
    with os.fdopen(slave, "r") as stream:
        yield Keyboard(stream), lambda text: (os.write(master, text.encode()), time.sleep(0.05))
    os.close(master)


def test_enter_agrees_once(keys):
    keyboard, press = keys
    with keyboard:
        assert not keyboard.go()
        press("\n")
        assert keyboard.stop() is None
        assert keyboard.go()
        assert not keyboard.go()


@pytest.mark.parametrize("key", ["q", " ", "\x1b"])
def test_any_other_key_stops_at_once_and_for_good(keys, key):
    keyboard, press = keys
    with keyboard:
        press(key)
        assert keyboard.stop() == f"operator stop: key {key!r}"
        press("\n")
        assert keyboard.stop() is not None
        assert not keyboard.go()


def test_a_keyboard_that_is_gone_stops():
    read, write = os.pipe()
    os.close(write)
    with os.fdopen(read, "r") as stream, Keyboard(stream) as keyboard:
        assert keyboard.stop() == "operator stop: the keyboard is gone"


def test_the_terminal_is_as_before(keys):
    import termios

    keyboard, _ = keys
    before = termios.tcgetattr(keyboard._stream)
    with keyboard:
        assert termios.tcgetattr(keyboard._stream) != before
    assert termios.tcgetattr(keyboard._stream) == before


@pytest.mark.parametrize("number", Interrupts.SIGNALS)
def test_a_signal_is_a_stop_and_the_second_one_an_exception(number):
    before = signal.getsignal(number)
    with Interrupts(Unattended()) as operator:
        assert operator.stop() is None
        os.kill(os.getpid(), number)
        assert operator.stop() == f"operator stop: {number.name}"
        assert operator.go()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
    assert signal.getsignal(number) is before


def test_other_threads_leave_signals_alone():
    found = []

    def work():
        with Interrupts(Unattended()) as operator:
            found.append(operator.stop())

    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert (found, signal.getsignal(signal.SIGINT)) == ([None], before)


def test_ctrl_c_ends_a_run_damped_logged_and_summarised(bundle_dir, tmp_path):
    """In a process of its own, in the middle of the simulation."""
    log = tmp_path / "run.mcap"
    program = f"""
import os, signal
import deploy
ticks = []
def press(sample):
    ticks.append(sample.tick.mode.value)
    if len(ticks) == 40:
        os.kill(os.getpid(), signal.SIGINT)
summary = deploy.run({str(bundle_dir)!r}, (0.3, 0.0, 0.0), 60.0, {str(log)!r}, on_tick=press)
assert summary.reason == "operator stop: SIGINT", summary.reason
assert ticks[-1] == "damp" and len(ticks) == 41, ticks
assert deploy.report({str(log)!r}) == summary
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


def test_a_key_ends_a_run(bundle_dir):
    read, write = os.pipe()
    with os.fdopen(read, "r", buffering=1) as stream, os.fdopen(write, "w", buffering=1) as typist:
        keyboard = Keyboard(stream)
        ticks = []

        def type_after(sample):
            ticks.append(sample.tick.mode.value)
            if len(ticks) in (5, 10, 50):  # the second one too early: nobody waits for it
                typist.write("\n")
                typist.flush()
            if len(ticks) == 100:
                typist.write("x")
                typist.flush()

        summary = run(bundle_dir, (0.3, 0, 0), 60.0, config=QUICK, operator=keyboard, on_tick=type_after)
    assert summary.reason == "operator stop: key 'x'"
    assert (ticks[4], ticks[5], ticks[49], ticks[50], ticks[-1]) == ("passive", "stand_up", "ready", "ramp_in", "damp")


def test_wall_clock_sleeps_until_its_time_and_not_into_the_past():
    clock = WallClock()
    start = clock.now_ns()
    assert abs(start - time.time_ns()) < 1_000_000_000
    clock.sleep_until(start + 20_000_000)
    assert start + 20_000_000 <= clock.now_ns() < start + 2_000_000_000
    before = time.monotonic()
    clock.sleep_until(start)
    assert time.monotonic() - before < 0.01
    assert not clock.virtual
