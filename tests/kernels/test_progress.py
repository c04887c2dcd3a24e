"""Slow steps are told on stderr."""

import re
import time

from oee_tabular import _progress


def test_slow_steps_are_reported_once_on_stderr(capsys, monkeypatch):
    monkeypatch.setattr(_progress, "SECONDS", 0.02)
    told = ""

    def wait_for(word):
        nonlocal told
        for _ in range(500):
            captured = capsys.readouterr()
            assert captured.out == ""
            told += captured.err
            if word in told:
                return
            time.sleep(0.02)
        raise AssertionError("not told")

    _progress.report_step("nobody listens")
    with _progress.show_steps():
        _progress.report_step("a first step")
        with _progress.show_steps():
            wait_for("first")
        _progress.report_step("a second step")
        wait_for("second")
        time.sleep(0.1)
    told += capsys.readouterr().err
    assert re.sub(r"\d+ s", "N s", told).splitlines() == ["oee: N s: a first step", "oee: N s: a second step"]
