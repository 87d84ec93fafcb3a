"""The view of a run in the terminal."""

import io
from dataclasses import replace

import pytest
from deploy import ControllerConfig, load_bundle, run
from deploy.cli import main
from deploy.commands import Pacer
from deploy.control.schedule import Slot
from deploy.live import LiveView
from deploy.logs.messages import Sample
from rich.console import Console

QUICK = ControllerConfig(passive_s=0.04, stand_up_s=0.2, hold_s=0.1, ramp_in_s=0.08)


def shown(view, sample):
    console = Console(file=io.StringIO(), width=120)
    console.print(view.table(sample))
    return console.file.getvalue()


def test_shows_what_a_tick_holds(seeing_dir):
    samples = []
    run(seeing_dir, (0.3, 0.0, 0.1), 0.3, config=QUICK, on_tick=samples.append)
    view = LiveView(load_bundle(seeing_dir), Console(file=io.StringIO()))
    text = shown(view, samples[-2])
    for words in ("policy", "+0.30 +0.00 +0.10", "velocity estimate", "headings", "tilt 0.", "FL_calf_joint"):
        assert words in text
    # a joint that stands in the middle of its range shows in the middle of its bar
    bundle = load_bundle(seeing_dir)
    state = samples[1].tick.state
    middle = 0.5 * (bundle.per_joint("lower") + bundle.per_joint("upper"))
    tick = replace(samples[1].tick, state=replace(state, q=middle), joint_command=None)
    assert shown(view, Sample(tick)).count(f"{'.' * 10}o{'.' * 10}") == 12
    end = shown(view, samples[-1])
    assert "damp" in end
    assert "finished" in end


def test_draws_seldom_and_always_the_end(bundle_dir):
    screen = io.StringIO()
    samples = []
    run(bundle_dir, (0.3, 0.0, 0.0), 0.3, config=QUICK, on_tick=samples.append)
    with LiveView(load_bundle(bundle_dir), Console(file=screen, force_terminal=True, width=120), hz=1e-3) as view:
        drawn = []
        view.table = lambda sample: drawn.append(sample.tick.mode.value) or "table"
        for sample in samples:
            view(sample)
    assert drawn == ["passive", "damp"]


def test_command_line_with_view_and_noise(bundle_dir, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(bundle_dir), "--duration", "0.2", "--live", "--disturb.joint-noise", "0.005"])
    assert exit_.value.code == 0
    assert "box trot" in capsys.readouterr().err


def test_pacer_keeps_real_time(monkeypatch):
    now = [5_000_000_000]
    naps = []
    monkeypatch.setattr("deploy.commands.time.monotonic_ns", lambda: now[0])
    monkeypatch.setattr("deploy.commands.time.sleep", naps.append)
    pacer = Pacer()

    class Nothing:
        pass

    for index in range(3):
        sample = Nothing()
        sample.tick = Nothing()
        sample.tick.slot = Slot(index, index * 20_000_000, index * 20_000_000, False, 0)
        pacer(sample)
        now[0] += 5_000_000
    assert naps == pytest.approx([0.0, 0.015, 0.03])
